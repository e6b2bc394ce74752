"""Make weights of the detector and of the digit reader: ``scripts/python -m scripts.build_weights``.

Renders what is learned from into ``--work``, trains there, and copies nets and cards. What is interrupted goes on when
the same command is given again; to start over, give an empty ``--work``. Needs ``simgrab[train]``.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click
import msgspec

from scripts import hanging_shapes
from scripts.background_photographs import SCENE, prepare, prepare_collages
from simgrab.cli import main as run
from simgrab.cli._progress import board, drawing
from simgrab.dataset.render import render
from simgrab.instrument.detect import WEIGHTS
from simgrab.io.files import drafted
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.factor import OneOf
from simgrab.training import need_torch
from simgrab.training.cli.train import follow

ROOT = Path(__file__).parents[1]
# Folders of photographs and the scene that shows them, and of shapes and their scenes.
BACKGROUNDS, COLLAGES, SHAPES = "backgrounds", "collages", "shapes"


@dataclass(frozen=True)
class Source:
    """A dataset to render: a scene, what differs from it, how many frames (and how many in a hurry), and the seed.

    ``kept`` names the places that a scene of many is kept to, each by the key that varies it. ``size``
    is the image size, px; the field of view stays. A scene that is a file is looked for in the folder of the datasets.
    """

    name: str
    scene: str
    changes: Mapping[str, Any]
    frames: int
    quick: int
    seed: int
    kept: Mapping[str, Sequence[str]] = field(default_factory=dict)
    size: tuple[int, int] | None = None


# Other cranes' grabs are what is taken for the grab: they stand where there is room, and still, so that few frames are
# of a world.
CROWDED: dict[str, Any] = {
    "swing.absent": 0.9,
    "clip.clip_frames": 4,
    "vary": {"clutter.other_grabs": {"dist": "one-of", "values": [1, 2, 3, 4], "weights": [1, 2, 2, 3]}},
}
ROOMY = {
    "place": (
        "quay, coal, hopper", "quay, ore, hopper", "quay, grain, hopper", "quay, coal, truck", "quay, ore, truck",
        "quay, bare", "water", "yard",
    )
}  # fmt: skip
NIGHT = {"weather": ("night", "night, rain", "night, light snow")}
HALF, SMALL = (960, 540), (640, 360)
ANY_KIND = {"dist": "one-of", "values": [["four-rope", "clamshell", "orange-peel", "assembled"]], "weights": [1]}
# Nets learn of all frames of a set, or of none: by the worlds and kinds that none learned of, the epoch is chosen, and
# presence, threshold and deviations are fitted.
ALL = {"splits": {"train": 1.0, "val": 0.0, "test": 0.0}}
NOTHING = {"splits": {"train": 0.0, "val": 1.0, "test": 0.0}}
ONE = {"clip.clip_frames": 1}
EMPTY = {"swing.absent": 0.98}  # a scene without any grab is refused
# Crops of each photograph, by folder; those of backgrounds are the first three.
NEGATIVES = {f"negatives-{i}": range(3 + 3 * i, 6 + 3 * i) for i in range(4)}
# Kinds that cranes have in places that look real; random shapes, another one in each frame; and scenes crowded with
# grabs of other cranes. Nets see less than half of the pixels: at half the size more frames are rendered in the same
# time.
PLACES = (
    Source("training", "training", ALL | {"clip.clip_frames": 3}, 900, 480, 0, size=HALF),
    Source("training-2", "training", ALL | {"clip.clip_frames": 3}, 600, 120, 2, size=HALF),
    Source("training-5", "training", ALL | {"clip.clip_frames": 3}, 900, 120, 5, size=HALF),
    # The lower edge of a grab in the dark was taken to be higher than it is.
    Source("night", "training", ALL | {"clip.clip_frames": 3}, 900, 120, 6, NIGHT, size=HALF),
    Source("empty", "training", ALL | EMPTY | {"clip.clip_frames": 2}, 800, 120, 4, size=HALF),
    *(Source(f"shapes-{seed}", "training-shapes", ALL, 350, 120, seed, size=HALF) for seed in range(2)),
    Source("crowded", "training", ALL | CROWDED | {"swing.absent": 0.4}, 180, 120, 3, ROOMY, size=HALF),
    Source("crowded-shapes", "training-shapes", ALL | CROWDED | ONE | {"swing.absent": 0.4}, 240, 120, 21, size=HALF),
    Source(
        "crowded-places", "training",
        ALL | CROWDED
        | {"swing.absent": 0.4, "clip.clip_frames": 2, "vary": CROWDED["vary"] | {"clutter.kinds": ANY_KIND}},
        120, 120, 22, ROOMY, size=HALF,
    ),
)  # fmt: skip
# Heaps, holds and hatches were taken for grabs, and parts of photographs.
NEGATIVE = tuple(
    Source(f"{folder}-{seed}", f"{folder}/{SCENE}", ALL | EMPTY, 1000, 120, seed, size=SMALL)
    for seed, folder in enumerate(NEGATIVES, 65)
)
# Over a photograph a frame takes a sixth of the time. Parts of large open grabs were taken for all of them: more are
# open.
APART: dict[str, Any] = {
    "swing.absent": 0.2,
    "swing.jaw_deg": {"dist": "choice", "values": [0.0, 8.0, 20.0, 35.0, 50.0], "weights": [5, 2, 2, 2, 2]},
}
PHOTOGRAPHS = tuple(
    Source(f"{folder}-{seed}", f"{folder}/{SCENE}", ALL | APART, 750, 120, seed, size=SMALL)
    for folder, first in ((BACKGROUNDS, 61), (COLLAGES, 71))
    for seed in range(first, first + 2)
)
# Shapes by other hands. No net learns of `JUDGES`, by which the epoch is chosen; robots are for exams only.
LEARNED = ("plain", "loads", "procedural", "tools", "animals", "furniture")
JUDGES = ("controllers", "household")


def _hung(names: Sequence[str], split: Mapping[str, Any], over: int, among: int, seed: int) -> Iterator[Source]:
    for i, name in enumerate(names):
        # As many in a hurry that leaving them out, by --without, shows.
        yield Source(f"{name}-photographs", f"{SHAPES}/{name}.toml", split, over, 150, seed + i, size=SMALL)
        yield Source(f"{name}-places", f"{SHAPES}/{name}-places.toml", split, among, 24, seed + i, size=HALF)


HUNG = tuple(_hung(LEARNED, ALL, 300, 60, 81))
JUDGED = (
    Source("judged", "training-shapes", CROWDED | NOTHING | ONE | {"swing.absent": 0.4}, 240, 120, 49, size=HALF),
    Source("judged-photographs", f"{BACKGROUNDS}/{SCENE}", APART | NOTHING, 240, 120, 50, size=SMALL),
    *_hung(JUDGES, NOTHING, 150, 60, 91),
)
DETECTOR = (*PLACES, *PHOTOGRAPHS, *NEGATIVE, *HUNG, *JUDGED)
# The second training begins with the nets of the first one, and adds these to what is learned from.
ADDED = ("night", *list(NEGATIVES)[2:])
# The third begins with the nets of the second one, and the fourth with those of the third, to learn from other frames,
# many of the four-rope grab; what comes out lies about half way, so that nothing learned before is forgotten.
MORE = tuple(
    replace(one, name=f"more-{one.name}", frames=one.frames // 3, quick=one.quick // 3, seed=one.seed + 200)
    for one in sorted(DETECTOR, key=lambda one: one.name)
    if one not in JUDGED
)
FOUR_ROPE = Source("four-rope", "training-large", ALL, 2400, 240, 7, {"grab": ("four-rope",)}, size=HALF)

SHOWN = {"coarse": 60_000, "pose": 340_000}
SHOWN_AFTER = {"coarse": 12_000, "pose": 160_000}
BATCHES = {"coarse": 32, "pose": 48}
STEADY = 0.998  # decay of the weights' average

READER = Source("digits", "digits", {}, 3024, 960, 0)


def rendered(sources: Sequence[Source], work: Path, *, quick: bool, workers: int) -> list[Path]:
    """Render datasets, or what is missing of them."""
    scenarios = [scenario(source, work, quick=quick) for source in sources]  # all of them, before hours of rendering
    out = [work / source.name for source in sources]
    for drawn, path in zip(scenarios, out, strict=True):
        with drawing(f"drawing {path.name}", shown=True) as (progress, checking):
            render(drawn, path, workers=workers, resume=True, progress=progress, checking=checking)
    return out


def scenario(source: Source, work: Path, *, quick: bool) -> Scenario:
    """Return what is rendered."""
    frames = source.quick if quick else source.frames
    scene = work / source.scene if source.scene.endswith(".toml") else source.scene
    result = scenes.load(scene, {**source.changes, "frames": frames, "seed": source.seed}, size=source.size)
    for key, names in source.kept.items():
        result = only(result, key, names)
    return result


def only(scenario: Scenario, key: str, names: Sequence[str]) -> Scenario:
    """Keep what varies a key, with others, to some of its values, by their names."""
    varied = next(keys for keys in scenario.vary if key in keys.split("+"))
    factor = scenario.vary[varied]
    assert isinstance(factor, OneOf)
    kept = [factor.names.index(name) for name in names]
    values, weights = (tuple(part[i] for i in kept) for part in (factor.values, factor.weights))
    fewer = msgspec.structs.replace(factor, values=values, weights=weights, names=tuple(names))
    return msgspec.structs.replace(scenario, vary={**scenario.vary, varied: fewer})


def detector(
    work: Path, *, quick: bool, workers: int, threads: int, device: str, loaders: int, without: str | None
) -> list[Path]:
    """Train the detector's nets, four times, or once without a collection of shapes; returns them."""
    from simgrab.training.detector.settings import Recipes, recipes
    from simgrab.training.detector.train import NETS, train

    def chosen(frames: int, *, started: bool, seed: int) -> Recipes:
        shown = None if quick else SHOWN_AFTER if started else SHOWN
        usual = recipes(
            frames, quick=quick, started=started, shown=shown, threads=threads, device=device, average=STEADY, seed=seed
        )
        return {net: replace(usual[net], batch=min(size, frames)) for net, size in BATCHES.items()}

    prepare_collages(prepare(work / BACKGROUNDS).parent, work / COLLAGES)
    for folder, crops in NEGATIVES.items():
        prepare(work / folder, crops)
    hanging_shapes.prepare(work / SHAPES)
    shutil.copytree(work / BACKGROUNDS / "photographs", work / SHAPES / "photographs", dirs_exist_ok=True)
    paths = rendered(DETECTOR, work, quick=quick, workers=workers)
    kept = [path for path in paths if without is None or not path.name.startswith(f"{without}-")]
    some = [path for path in kept if not path.name.startswith(ADDED)]
    first, second, third, last = (work / name for name in ("detector-1", "detector-2", "detector-3", "detector"))
    # Where to, what the nets begin with, what is learned from, the seed, and the share of the trained weights.
    trainings: list[tuple[Path, Path | None, list[Path], int, float]]
    if without:
        trainings = [(work / f"without-{without}", None, some, 0, 1.0)]
    else:
        more = rendered((*MORE, FOUR_ROPE), work, quick=quick, workers=workers) + paths[-len(JUDGED) :]
        trainings = [
            (first, None, some, 0, 1.0), (second, first, paths, 0, 1.0), (third, second, more, 1, 0.5),
            (last, third, more, 2, 0.4),
        ]  # fmt: skip
    for into, start, learned, seed, share in trainings:
        if (into / f"{NETS[-1]}.md").exists():  # a card is written last
            continue
        with board(shown=True) as progress:
            train(
                learned, into, functools.partial(chosen, started=start is not None, seed=seed), start=start,
                share=share, resume=True, watch=progress.step, report=functools.partial(follow, progress),
                loaders=loaders,
            )  # fmt: skip
    return [trainings[-1][0] / f"{name}.onnx" for name in NETS]


def reader(work: Path, *, quick: bool, workers: int) -> list[Path]:
    """Train the reader, which gains nothing by a second thread; returns its net."""
    from simgrab.training.reader.train import QUICK_EPOCHS, RECIPE, train_reader

    datasets = rendered([READER], work, quick=quick, workers=workers)
    out = work / "reader"
    recipe = replace(RECIPE, epochs=QUICK_EPOCHS) if quick else RECIPE
    with board(shown=True) as shown:
        train_reader(datasets, out, recipe, resume=True, report=follow(shown, "reader"))
    return [out / "reader.onnx"]


def install(nets: Sequence[Path], out: Path) -> None:
    """Copy nets and their cards; broken off, it leaves no pose net, and so no mixture that can be used."""
    for net in nets:
        net.with_suffix(".md").resolve(strict=True)  # a card is written last
    if len(nets) > 1:
        (out / LAST).unlink(missing_ok=True)
    for net in sorted(nets, key=lambda net: net.name == LAST):
        for suffix in (".json", ".md", ".onnx"):
            with drafted(out / f"{net.stem}{suffix}") as draft:
                shutil.copyfile(net.with_suffix(suffix), draft)


LAST = "pose.onnx"  # with it, a folder is a detector


@click.command()
@click.option("--quick", is_flag=True, help="Fewer frames, and about a fifth of the time in training.")
@click.option("--only", type=click.Choice(["reader", "detector"]), help="Build one part.")
@click.option(
    "--without",
    type=click.Choice(LEARNED),
    help="Train the detector once without a collection of shapes, in --work; the nets are not copied.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Gets the nets.  [default: assets/weights; with --quick, in --work]"
)
@click.option("--work", type=click.Path(path_type=Path), help="Datasets and checkpoints.  [default: runs/weights]")
@click.option("--workers", default=2, show_default=True, help="Processes that draw.")
@click.option("--threads", default=2, show_default=True, help="Of torch.")
@click.option("--device", default="cpu", show_default=True, help="Of torch, for the detector.")
@click.option("--loaders", default=0, show_default=True, help="Processes that make batches, for the detector.")
def main(
    quick: bool, only: str | None, without: str | None, out: Path | None, work: Path | None, workers: int, threads: int,
    device: str, loaders: int,
) -> None:  # fmt: skip
    """Make the weights of the digit reader and of the detector again."""
    if without and (only == "reader" or out):
        raise click.UsageError(
            "--without is for the detector alone, which is not copied: leave out --only reader and --out"
        )
    need_torch()
    work = work or ROOT / "runs" / ("weights-quick" if quick else "weights")
    out = out or (work / "weights" if quick else WEIGHTS)
    work.mkdir(parents=True, exist_ok=True)
    trained = functools.partial(
        detector, work, quick=quick, workers=workers, threads=threads, device=device, loaders=loaders, without=without
    )
    if without:
        click.echo(f"detector: {trained()[0].parent}")
        return
    for name in [only] if only else ("reader", "detector"):
        nets = reader(work, quick=quick, workers=workers) if name == "reader" else trained()
        install(nets, out)
        click.echo(f"{name}: {', '.join(net.name for net in nets)} in {out}")


if __name__ == "__main__":
    run(main)

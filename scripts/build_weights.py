"""Make weights of the digit reader and of the detector `any-grab`: ``python -m scripts.build_weights``.

`any-grab` is made in two parts, each of which begins with what the part before has made: ``detector`` trains three nets
from those of the default detector, ``verify`` adds the fourth. The shipped weights were made in more parts, by this
script as it was in commit 4c24e0f, from the same datasets; the default detector by that of commit 2a7ba2c, when the
scene `training` showed the four-rope grab alone.

Renders what is learned from into ``--work``, trains there, and copies nets and cards. What is interrupted goes on when
the same command is given again; to start over, give an empty ``--work``. Needs ``simgrab[train]``.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click
import msgspec

from scripts.background_photographs import SCENE, prepare, prepare_collages
from simgrab.cli import main as run
from simgrab.cli._progress import drawing
from simgrab.dataset.render import render
from simgrab.instrument.detect import GENERIC, WEIGHTS
from simgrab.io.files import drafted, drafted_folder
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.factor import OneOf
from simgrab.training import need_torch
from simgrab.training.cli._board import board

ROOT = Path(__file__).parents[1]
BACKGROUNDS, COLLAGES = "backgrounds", "collages"  # folders of photographs, and the scene that shows them


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
SHAPE_SETS, HALF = 6, (960, 540)
# Real kinds in real places; and random shapes, another one in each frame, in several sets, each of which is resumed by
# itself. Nets see less than half of the pixels: at half the size more frames are rendered in the same time. Sets of one
# seed have the same cameras and weather, and the same split.
DETECTOR = (
    Source("training", "training", {"clip.clip_frames": 3}, 1500, 480, 0),
    *(Source(f"shapes-{seed}", "training-shapes", {}, 500, 120, seed, size=HALF) for seed in range(SHAPE_SETS)),
)
# What find has not learned, and so what it takes for the grab in them, teaches settle what none is.
ANY_KIND = {"dist": "one-of", "values": [["four-rope", "clamshell", "orange-peel", "assembled"]], "weights": [1]}
HARD = (
    Source("hard", "training", CROWDED | {"clip.clip_frames": 2}, 240, 240, 3, ROOMY),
    Source("hard-shapes", "training-shapes", CROWDED | {"clip.clip_frames": 1}, 420, 120, 21, size=HALF),
    Source(
        "hard-places", "training",
        CROWDED | {"clip.clip_frames": 2, "vary": CROWDED["vary"] | {"clutter.kinds": ANY_KIND}}, 300, 120, 22, ROOMY,
        size=HALF,
    ),
)  # fmt: skip

# What no net has learned: verify learns from what the others take for the grab. Most frames show the grab, and
# with it ropes that do not end at those that are parked.
MIXED: dict[str, Any] = CROWDED | {"swing.absent": 0.4, "clip.clip_frames": 2}
VERIFY: tuple[Source, ...] = (
    Source("verify-training", "training", {"clip.clip_frames": 3}, 240, 120, 41),
    Source("verify-shapes", "training-shapes", {}, 300, 120, 42, size=HALF),
    Source("verify-hard-shapes", "training-shapes", MIXED | {"clip.clip_frames": 1}, 600, 120, 44, size=HALF),
    Source(
        "verify-hard-places", "training", MIXED | {"vary": CROWDED["vary"] | {"clutter.kinds": ANY_KIND}}, 240, 120, 45,
        ROOMY, size=HALF,
    ),
    Source("verify-photo", f"{BACKGROUNDS}/{SCENE}", {}, 480, 120, 46, size=(640, 360)),
)  # fmt: skip

# Random shapes are what all nets lack most, and over a photograph a frame takes a sixth of the time.
PHOTO_SETS = 3
DETECTOR += tuple(
    Source(f"photo-shapes-{seed}", f"{BACKGROUNDS}/{SCENE}", {"swing.absent": 0.1}, 1500, 120, seed, size=(640, 360))
    for seed in range(61, 61 + PHOTO_SETS)
)
# Over collages, and more of them open: nets took a heap of cargo below the grab for its outline, and a part of a large
# open grab for all of it.
COLLAGE_SETS = 3
APART: dict[str, Any] = {
    "swing.absent": 0.15,
    "swing.jaw_deg": {"dist": "choice", "values": [0.0, 8.0, 20.0, 35.0, 50.0], "weights": [5, 2, 2, 2, 2]},
}
DETECTOR += tuple(
    Source(f"collage-shapes-{seed}", f"{COLLAGES}/{SCENE}", APART, 1500, 120, seed, size=(640, 360))
    for seed in range(71, 71 + COLLAGE_SETS)
)

# What verify learned from further, when the other nets had changed.
VERIFY += (
    Source("verify-hard-shapes-47", "training-shapes", MIXED | {"clip.clip_frames": 1}, 900, 120, 47, size=HALF),
    Source("verify-collage-74", f"{COLLAGES}/{SCENE}", APART | {"swing.absent": 0.3}, 1200, 120, 74, size=(640, 360)),
)
# Of each of these worlds nothing is learned: they show what else may be taken for the grab, by which the presence
# threshold is chosen.
VERIFY += (
    Source(
        "judged", "training-shapes", MIXED | {"clip.clip_frames": 1, "splits": {"train": 0.0, "val": 1.0, "test": 0.0}},
        300, 120, 49, size=HALF,
    ),
)  # fmt: skip
DETECTOR += (Source("training-48", "training", {"clip.clip_frames": 3}, 300, 120, 48, size=HALF),)

# Nets that had seen less did no better on what they had learned than on what they had not: that they see it longer and
# in larger batches is what helped. Nets of 2.5 to 4 times as many weights were behind after the same time.
SHOWN = {"find": 685_000, "refine": 1_255_000, "settle": 146_000}
BATCHES = {"find": 64, "refine": 256, "settle": 64}
STEADY = 0.9995  # decay of the weights' average

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
    work: Path, *, quick: bool, start: Path, workers: int, threads: int, device: str, loaders: int
) -> list[Path]:  # fmt: skip
    """Train three nets; returns them."""
    from simgrab.training.detector.settings import Recipes, recipes
    from simgrab.training.detector.train import NETS, train

    def chosen(frames: int) -> Recipes:
        # At the full learning rate, even after trained weights: there is much that these have not learned.
        usual = recipes(frames, quick=quick, shown=None if quick else SHOWN, threads=threads, device=device)
        return Recipes(**{
            net: replace(getattr(usual, net), batch=min(size, frames), average=STEADY) for net, size in BATCHES.items()
        })  # fmt: skip

    prepare_collages(prepare(work / BACKGROUNDS).parent, work / COLLAGES)
    learned, hard = (rendered(some, work, quick=quick, workers=workers) for some in (DETECTOR, HARD))
    out = work / "detector"
    with board(shown=True) as progress:
        train(
            learned, out, chosen, hard=hard, start=start, resume=True, watch=progress.step, report=progress.training,
            loaders=loaders,
        )  # fmt: skip
    return [out / f"{name}.onnx" for name in NETS]


def verify(work: Path, *, quick: bool, start: Path, workers: int, threads: int, **_: Any) -> list[Path]:
    """Train a fourth net for a detector of three; returns all four."""
    from simgrab.training.detector.train import NETS
    from simgrab.training.detector.verify import recipe, train_verify

    prepare_collages(prepare(work / BACKGROUNDS).parent, work / COLLAGES)
    paths, out = rendered(VERIFY, work, quick=quick, workers=workers), work / "verify"
    with board(shown=True) as shown:
        train_verify(
            paths, start, out, recipe(quick=quick, threads=threads), resume=True, watch=shown.step,
            report=shown.training("verify"),
        )  # fmt: skip
    return [out / f"{net}.onnx" for net in (*NETS, "verify")]


def reader(work: Path, *, quick: bool, workers: int) -> list[Path]:
    """Train the reader, which gains nothing by a second thread; returns its net."""
    from simgrab.training.reader.train import QUICK_EPOCHS, RECIPE, train_reader

    datasets = rendered([READER], work, quick=quick, workers=workers)
    out = work / "reader"
    recipe = replace(RECIPE, epochs=QUICK_EPOCHS) if quick else RECIPE
    with board(shown=True) as shown:
        train_reader(datasets, out, recipe, resume=True, report=shown.training("reader"))
    return [out / "reader.onnx"]


def install(nets: Sequence[Path], out: Path) -> None:
    """Copy nets and their cards; broken off among several, it leaves no settle, and so no mixture that can be used."""
    if len(nets) > 1:
        (out / LAST).unlink(missing_ok=True)
    for net in sorted(nets, key=lambda net: net.name == LAST):
        for suffix in (".json", ".md", ".onnx"):
            with drafted(out / f"{net.stem}{suffix}") as draft:
                shutil.copyfile(net.with_suffix(suffix), draft)


def copied(start: Path, folder: Path) -> Path:
    """Copy the detector that a part begins with, unless it is there: what is made of it may take its place."""
    from simgrab.training.detector import export

    if not folder.exists():
        with drafted_folder(folder) as draft:
            export.copy([path.stem for path in start.glob("*.onnx")], start, draft)
    return folder


DETECTS: dict[str, Callable[..., list[Path]]] = {"detector": detector, "verify": verify}
LAST = "settle.onnx"  # with it, a folder is a detector


@click.command()
@click.option("--quick", is_flag=True, help="Fewer frames, and about a fifth of the time in training.")
@click.option("--only", type=click.Choice(["reader", *DETECTS]), help="Build one part.")
@click.option(
    "--from",
    "start",
    type=click.Path(path_type=Path, exists=True),
    help="Detector that the part detector begins with.  [default: assets/weights]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Gets reader.onnx and any-grab.  [default: assets/weights; with --quick, in --work]",
)
@click.option("--work", type=click.Path(path_type=Path), help="Datasets and checkpoints.  [default: runs/weights]")
@click.option("--workers", default=2, show_default=True, help="Processes that draw.")
@click.option("--threads", default=2, show_default=True, help="Of torch.")
@click.option("--device", default="cpu", show_default=True, help="Of torch, for the part detector.")
@click.option("--loaders", default=0, show_default=True, help="Processes that make batches, for the part detector.")
def main(
    quick: bool, only: str | None, start: Path | None, out: Path | None, work: Path | None, workers: int, threads: int,
    device: str, loaders: int,
) -> None:  # fmt: skip
    """Make the weights of the digit reader and of any-grab again."""
    if start is not None and only not in (None, "detector"):
        raise click.UsageError(f"--from belongs to the part detector, not to {only}")
    need_torch()
    work = work or ROOT / "runs" / ("weights-quick" if quick else "weights")
    out = out or (work / "weights" if quick else WEIGHTS)
    work.mkdir(parents=True, exist_ok=True)
    for name in [only] if only else ("reader", *DETECTS):
        if name == "reader":
            nets, target = reader(work, quick=quick, workers=workers), out
        else:
            target = out / GENERIC
            begin = copied((start or WEIGHTS) if name == "detector" else target, work / f"before-{name}")
            nets = DETECTS[name](
                work, quick=quick, start=begin, workers=workers, threads=threads, device=device, loaders=loaders
            )
        install(nets, target)
        click.echo(f"{name}: {', '.join(net.name for net in nets)} in {target}")


if __name__ == "__main__":
    run(main)

"""Repeat the paper's trainings, and what it could not see: ``python -m scripts.training_studies [STUDY ...]``.

Studies: ``table`` (learning rates and optimisers), ``digits``, ``leak`` (one video split at random, against what was
not in it), ``counts`` (accuracy against how many frames were learned from). What is done is kept in ``--work`` and not
done again; `scripts.training_page` writes ``docs/results/training-studies.md``. Needs ``simgrab[train]`` and 20 GB.
"""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from simgrab import scenes
from simgrab.cli import main as run
from simgrab.cli._progress import board, drawing
from simgrab.errors import TrainingError
from simgrab.geometry import PAPER_PIXELS_PER_MM
from simgrab.instrument.detect.bundled import Bundled
from simgrab.instrument.detect.patches import FIND_HEIGHT, FIND_WIDTH, whole
from simgrab.instrument.read.reader import NO_DIGIT
from simgrab.judge.evaluate import detection
from simgrab.labels import datasets
from simgrab.labels.truth import Row
from simgrab.records.observations import Detection
from simgrab.rng import stream
from simgrab.training import loop
from simgrab.training.detector import cache, evaluate, find
from simgrab.training.detector.nets import Find
from simgrab.training.detector.settings import SHOWN_QUICK, Recipes, has_half_units, recipes
from simgrab.training.detector.train import Frames, fit
from simgrab.training.folder import claim, write
from simgrab.training.reader.cells import Cells, gather
from simgrab.training.reader.lenet import LeNet5
from simgrab.training.reader.task import Digits
from simgrab.training.recipe import Recipe
from simgrab.world.output.dataset import render

RATES, OPTIMISERS, FINALS = (0.0005, 0.001, 0.005, 0.01), ("sgd", "adam"), (0.001, 0.005, 0.01)
COUNTS = (50, 200, 800, 3200, 10_000)
# Whatever the count: pictures in an epoch at least, and frames shown to each net in all.
EPOCH, SHOWN = 3200, {"find": 14_000, "refine": 42_000, "settle": 10_000}
JUDGES = 5  # of so many validation frames one is evaluated
EPOCHS = 30  # of the table's trainings
LEARNED = 0.8  # share of the paper's splits
CROPS = 320
SPLITS = ("train", "val", "test")
RESULTS = "results.json"

Indices = NDArray[np.int64]
Piece = tuple[str, Callable[[], Any]]


@dataclass(frozen=True)
class Record:
    """A video's frames: a scene, how many, seconds between them, and the seed."""

    scene: str
    frames: int
    step_s: float
    seed: int


# The paper labelled 340 frames of one video; what comes 20 s after them in ours is tested on.
VIDEO, LABELLED, LATER = Record("qingdao-twin", 440, 1.0, 11), 340, 360
OTHERS = {
    "another video, grab and ground otherwise stained": Record("qingdao-twin", 80, 4.0, 12),
    "the same at night in light snow": Record("qingdao-night-snow", 80, 1.5, 13),
    "the same in heavy snow": Record("qingdao-heavy-snow", 80, 2.0, 14),
    "another place, independent frames": Record("windy-day", 80, 1.0, 15),
}
# Small pictures and forty of each world, so that so many are rendered within the hour; the blur shrinks with them.
WORLDS: dict[str, Any] = {
    "frames": 12_600, "seed": 16, "clip.clip_frames": 40, "image.samples": 2,
    "camera.width_px": 640, "camera.height_px": 360, "camera.focal.pixels_per_mm": PAPER_PIXELS_PER_MM / 3,
    "optics.defocus_px": 0.5, "optics.chromatic_px": 0.0,
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """Where a study works, and how it is rendered and trained."""

    work: Path
    workers: int
    threads: int
    seed: int

    @property
    def common(self) -> dict[str, Any]:
        """What all recipes have in common."""
        return {"seed": self.seed, "threads": self.threads}

    def recipe(self, **changes: Any) -> Recipe:
        """Return a recipe for this machine."""
        return Recipe(half=has_half_units("cpu"), **self.common, **changes)


def identity(study: str, seed: int) -> dict[str, Any]:
    """Tell, as plain data, what a study's results depend on, the training's own code left out."""
    video = {"video": VIDEO, "labelled": LABELLED, "learned": LEARNED}
    depends: dict[str, dict[str, Any]] = {
        "table": video | {"epochs": EPOCHS},
        "digits": video | {"crops": CROPS},
        "leak": video | {"later": LATER, "others": OTHERS, "quick": SHOWN_QUICK},
        "counts": {"worlds": WORLDS, "shown": SHOWN, "epoch": EPOCH, "judges": JUDGES},
    }
    plain: dict[str, Any] = msgspec.to_builtins({"seed": seed} | depends[study])
    return plain


def results(kept: Path, seed: int) -> dict[str, Any]:
    """Return what a file keeps of each study: ``of`` what it is, and what was ``found``, piece by piece.

    Raises
    ------
    TrainingError
        If a study in it is of another seed or recipe.
    """
    known: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    for name, study in known.items():
        if study["of"] != identity(name, seed):
            raise TrainingError(f"{kept}: {name} is of another seed or recipe; choose another --work, or take it out")
    return known


def filmed(record: Record, s: Settings) -> datasets.Dataset:
    """Render a record."""
    changes = {"frames": record.frames, "seed": record.seed, "clip.frame_rate_hz": 1 / record.step_s}
    return rendered(record.scene, changes, s)


def rendered(scene: str, changes: dict[str, Any], s: Settings) -> datasets.Dataset:
    """Render a dataset, or what is missing of it."""
    scenario = scenes.load(scene, changes)
    out = s.work / f"{scene}-{scenario.seed}-{scenario.frames}"
    with drawing(f"drawing {out.name}", shown=True) as (progress, checking):
        render(scenario, out, workers=s.workers, resume=True, progress=progress, checking=checking)
    return datasets.read(out)


def all_frames(dataset: datasets.Dataset) -> list[cache.Frame]:
    """All frames of a dataset, whatever its own split, in order."""
    frames = [frame for split in SPLITS for frame in cache.frames([dataset], split)]
    return sorted(frames, key=lambda frame: frame.row.frame)


def at_random(n: int, seed: int) -> tuple[Indices, Indices]:
    """Split indices into those to learn from and those to test on, as the paper did."""
    order = stream(seed, 0, "split").permutation(n)
    return np.sort(order[: round(LEARNED * n)]), np.sort(order[round(LEARNED * n) :])


def precision(frames: Sequence[cache.Frame], found: Sequence[Detection]) -> float:
    """COCO's mAP50-95."""
    cases = []
    for f, d in zip(frames, found, strict=True):
        assert isinstance(f.row, Row)  # rendered
        cases.append(detection.Case(f.row, f.labelled, f.weather, d))
    return float(detection.average_precision(cases)["map50_95"] or 0.0)


def by_find(net: torch.nn.Module, pictures: find.Pictures, frames: Sequence[cache.Frame]) -> list[Detection]:
    """Run find alone on pictures."""
    with torch.inference_mode():
        scores, boxes = find.look(net, pictures.pictures)
    result = []
    for frame, score, box in zip(frames, scores, boxes, strict=True):
        patch, limits = whole(frame.row.width_px, frame.row.height_px), [frame.row.width_px, frame.row.height_px] * 2
        corners = patch.to_picture(box.reshape(2, 2) / (FIND_WIDTH, FIND_HEIGHT)).ravel()
        result.append(Detection("found", "", float(score), np.clip(corners, 0, limits)))
    return result


def learned(
    build: Callable[[], torch.nn.Module], task: loop.Task, recipe: Recipe, out: Path, data: str
) -> torch.nn.Module:
    """Train a net, or find it trained on the same data."""
    out.mkdir(parents=True, exist_ok=True)
    with board(shown=True) as shown:
        return loop.train(build, task, recipe, out, data=data, resume=True, report=shown.training(out.name)).net


def table(s: Settings) -> Iterator[Piece]:
    """Measure find alone (mAP) on the grid of rates and optimisers; the best epoch on the tested frames, as there."""
    frames = all_frames(filmed(VIDEO, s))[:LABELLED]
    data = Frames(frames, ()).digest
    whole_set = find.pictures(s.work / f"small-{data[:16]}", frames)
    train_part, test_part = (
        find.Pictures(whole_set.pictures[which], whole_set.boxes[which]) for which in at_random(len(frames), s.seed)
    )
    tested = [frames[i] for i in at_random(len(frames), s.seed)[1]]

    def one(optimiser: str, rate: float, final: float, out: Path) -> float:
        changes = {"optimiser": optimiser, "rate": rate, "final": final, "weight_decay": 5e-4}
        recipe = s.recipe(epochs=EPOCHS, batch=16, average=0.99, **changes)
        net = learned(Find, find.Finding(train_part, test_part), recipe, out, data)
        return precision(tested, by_find(net, test_part, tested))

    for optimiser in OPTIMISERS:
        for rate in RATES:
            for final in FINALS:
                name = f"{optimiser} {rate:g} {final:g}"
                out = s.work / "table" / name.replace(" ", "-")
                yield name, functools.partial(one, optimiser, rate, final, out)


def digits(s: Settings) -> Iterator[Piece]:
    """LeNet-5 on 320 crops of digits."""

    def one() -> dict[str, int]:
        dataset = filmed(VIDEO, s)
        rows = tuple(msgspec.structs.replace(row, split="train") for row in dataset.rows[:LABELLED])
        cells = gather([replace(dataset, rows=rows)], "train", s.seed)
        shown = stream(s.seed, 0, "crops").choice(np.flatnonzero(cells.digits != NO_DIGIT), CROPS, replace=False)
        train_part, test_part = (_some(cells, shown[which]) for which in at_random(CROPS, s.seed))
        task = Digits(train_part, test_part, s.seed)
        recipe = s.recipe(epochs=60, batch=32, rate=3e-3, weight_decay=0.01, average=0.9)
        net = learned(LeNet5, task, replace(recipe, half=False), s.work / "digits", datasets.digest([dataset]))
        with torch.inference_mode():  # the first of the validation crops are as they lie
            told = net(torch.from_numpy(task.crops[: len(test_part)])).argmax(1).numpy()
        return {"tested": len(test_part), "right": int((told == test_part.digits).sum())}

    yield "digits", one


def _some(cells: Cells, which: Indices) -> Cells:
    numbers = np.arange(len(which))
    return Cells(tuple(cells.boxes[i] for i in which), cells.digits[which], numbers, ("",) * len(which))


def leak(s: Settings) -> Iterator[Piece]:
    """Learn the whole detector from one video; score it on frames in between, on later ones, and on other videos."""

    def one() -> dict[str, Any]:
        frames = all_frames(filmed(VIDEO, s))
        known, between = ([frames[i] for i in which] for which in at_random(LABELLED, s.seed))
        judged = known[::8]
        part = Frames([frame for frame in known if frame not in judged], judged)
        looks = _detector(s.work / "leak", part, recipes(len(part.train), quick=True, **s.common))
        sets = {"frames in between": between, "later in the same video": frames[LATER:]}
        sets |= {name: all_frames(filmed(record, s)) for name, record in OTHERS.items()}
        return {name: _scores(looks, some) for name, some in sets.items()}

    yield "leak", one


def counts(s: Settings) -> Iterator[Piece]:
    """Learn the whole detector from so many frames, of as many worlds as there are, always for as long."""

    def one(count: int) -> dict[str, Any]:
        dataset = rendered("training", WORLDS, s)
        learn, val, test = (cache.frames([dataset], split) for split in SPLITS)
        if count > len(learn):
            raise TrainingError(f"there are {len(learn)} frames to learn from, and {count} are wanted")
        some = [learn[i] for i in np.linspace(0, len(learn) - 1, count).round().astype(int)]
        part = Frames([some[i % count] for i in range(max(count, EPOCH))], val[::JUDGES])
        epochs = {name: round(shown / len(part.train)) for name, shown in SHOWN.items()}
        usual = recipes(len(part.train), **s.common)
        chosen = Recipes(**{name: replace(getattr(usual, name), epochs=number) for name, number in epochs.items()})
        return _scores(_detector(s.work / "counts" / str(count), part, chosen), test)

    for count in COUNTS:
        yield str(count), functools.partial(one, count)


def _detector(out: Path, frames: Frames, chosen: Recipes) -> Bundled:
    out.mkdir(parents=True, exist_ok=True)
    with board(shown=True) as shown:
        fit(frames, out, chosen, resume=True, report=shown.training)
    shutil.rmtree(out / "cache")
    return Bundled(out)


def _scores(looks: Bundled, some: Sequence[cache.Frame]) -> dict[str, Any]:
    seen = evaluate.watch(looks, some)
    return {"map50_95": precision(some, [one.detection for one in seen])} | {
        name: value for name, value in evaluate.metrics(seen).items() if name != "by_weather"
    }


STUDIES: dict[str, Callable[[Settings], Iterator[Piece]]] = {
    "table": table, "digits": digits, "leak": leak, "counts": counts,
}  # fmt: skip


@click.command()
@click.argument("studies", nargs=-1, type=click.Choice(list(STUDIES)))
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/training-studies"), show_default=True)
@click.option("--workers", default=2, show_default=True, help="Processes that draw.")
@click.option("--threads", default=2, show_default=True, help="Of torch.")
@click.option("--seed", default=0, show_default=True)
def main(studies: tuple[str, ...], work: Path, workers: int, threads: int, seed: int) -> None:
    """Repeat the paper's trainings, and what it could not see."""
    kept, settings = work / RESULTS, Settings(work, workers, threads, seed)
    with claim(work, resume=True, traces=(RESULTS,)):
        known = results(kept, seed)
        for study in studies or STUDIES:
            done = known.setdefault(study, {"of": identity(study, seed), "found": {}})["found"]
            for name, piece in STUDIES[study](settings):
                if name not in done:
                    done[name] = piece()
                    write(kept, json.dumps(known, indent=1).encode())
                click.echo(f"{study}, {name}: {done[name]}")


if __name__ == "__main__":
    run(main)

"""Train the detector, from datasets to ONNX files with their cards."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from simgrab.dataset import datasets
from simgrab.errors import TrainingError
from simgrab.instrument.detect.bundled import FIND, PASSES, REFINE, SETTLE, GrabDetector, Settings, peaks
from simgrab.instrument.detect.flips import WAYS
from simgrab.instrument.detect.patches import FIND_HEIGHT, FIND_WIDTH, REFINE_SIZE, whole
from simgrab.instrument.net import MOST_BYTES, open_net
from simgrab.io.files import scratch, sha256
from simgrab.io.parse import read_bytes
from simgrab.model.geometry import Array
from simgrab.training import loop
from simgrab.training.card import Card
from simgrab.training.detector import cache, evaluate, export, find, refine, settle
from simgrab.training.detector.nets import Find, Refine
from simgrab.training.detector.real import Real
from simgrab.training.detector.settings import Recipes
from simgrab.training.detector.start import begun, some_examples
from simgrab.training.device import named
from simgrab.training.folder import check, claim

_SUSPECT = 0.05  # heat from which on a place that is no grab makes a hard example
_BATCH = 32  # batch of find, pictures

NETS = ("find", "refine", "settle")
Watch = Callable[[str], Callable[[int, int], None]]
TASKS = {
    "find": "Picture of 512 x 288 in, heat at the centre of the grab's visible box and the distances to its edges out.",
    "refine": "Crop around a found box in; its edges, the grab's centre, its yaw, how sure each is, and whether it is "
    "there out.",
    "settle": "Crop around a refined grab, turned level, in; the grab's centre and yaw, how sure they are, and whether "
    "it is there out.",
}


@dataclass(frozen=True)
class Result:
    """A trained detector: its folder, and its figures on validation frames."""

    folder: Path
    metrics: dict[str, Any]


def train(
    paths: Sequence[str | Path],
    out: str | Path,
    recipes: Callable[[int], Recipes],
    *,
    hard: Sequence[str | Path] = (),
    real: Real | None = None,
    start: str | Path | None = None,
    resume: bool = False,
    watch: Watch | None = None,
    report: Callable[[str], Callable[[loop.TrainingReport], None]] | None = None,
    loaders: int = 0,
) -> Result:
    """Train find, refine on what find takes for the grab, and settle on what refine makes of it; measure all together.

    Settle begins with refine's weights, or with those of settle in ``start``. The fourth net of ``start``, if there is
    one, is copied.

    Figures of rendered validation frames and of real frames stand apart: the latter are ``real`` and ``real_…``.

    Parameters
    ----------
    paths : sequence of paths
        Datasets; frames of the split ``train`` are learned from, those of ``val`` judged by.
    out : path
        Gets three nets (`NETS`), their cards, checkpoints, and a cache of pictures that may be deleted.
    recipes : callable
        From the number of frames to learn from to the recipes.
    hard : sequence of paths, optional
        Datasets, mostly of no grab, that settle alone learns from: what find takes for the grab in pictures that it has
        not learned is what it will take for it at work.
    real : Real, optional
        Real frames: to learn from beside the others, to choose the presence threshold by, and to judge by.
    start : path, optional
        Folder of a trained detector whose weights the nets begin with, instead of random ones.
    resume : bool
        Go on with an interrupted training of the same recipes and datasets.
    watch, report : callable, optional
        Given the name of a step, return the callback of its progress.
    loaders : int
        Processes that make batches (`simgrab.training.loop.train`).

    Raises
    ------
    DatasetError, TrainingError
    """
    out = Path(out)
    check(out, resume=resume)
    first = start_digests(start)
    sets, more = datasets.read_all(paths, "train", "val"), datasets.read_all(hard, "train") if hard else ()
    frames, doubtful = FrameSplits.of(sets), FrameSplits.of(more)
    rendered = len(frames.train)
    if real:
        frames = FrameSplits([*frames.train, *real.repeated(rendered)], frames.val, real.val)
    chosen = recipes(len(frames.train))
    named(chosen.find.device)  # or refused before anything is written
    with claim(out, resume=resume):
        fitted = fit(
            frames, out, chosen, hard=doubtful, start=start, resume=resume, watch=watch, report=report,
            loaders=loaders,
        )  # fmt: skip
        if real:
            fitted = Fitted(fitted.nets, fitted.metrics | real.figures(out, start, watch))
        for name, trained in fitted.nets.items():
            learned, others = ((*sets, *more), ()) if name == "settle" else (sets, more)
            Card(
                name=name, task=TASKS[name], data=tuple(one.data for one in learned), examples=trained.examples,
                recipe=dataclasses.asdict(getattr(chosen, name)), epochs=trained.epochs, seconds=trained.seconds,
                metrics={"alone": trained.figures, "best_epoch": trained.epoch} | fitted.metrics,
                judged_by=tuple(one.data for one in others), started_from=first.get(name, ""),
                real=real.learned(rendered) if real else {},
            ).save(out / f"{name}.onnx")  # fmt: skip
    return Result(out, fitted.metrics)


@dataclass(frozen=True, eq=False)
class FrameSplits:
    """Frames to learn from and to judge by, and real ones that only the presence threshold and deviations are of."""

    train: Sequence[cache.TrainingFrame]
    val: Sequence[cache.TrainingFrame]
    real: Sequence[cache.TrainingFrame] = ()

    @classmethod
    def of(cls, sets: Sequence[datasets.Dataset]) -> FrameSplits:
        """Take the frames of datasets' splits."""
        return cls(cache.frames(sets, "train"), cache.frames(sets, "val"))

    @functools.cached_property
    def digest(self) -> str:
        """What names them, labels and all: a checkpoint or a cache of others is not taken up."""
        rows = [[(frame.row, frame.labelled) for frame in some] for some in (self.train, self.val)]
        return hashlib.sha256(msgspec.json.encode(rows)).hexdigest()


@dataclass(frozen=True, eq=False)
class Fitted:
    """The nets by name, and their figures together on validation frames."""

    nets: dict[str, loop.Trained]
    metrics: dict[str, Any]
    """With ``before``, those of the detector that it started with, where there is one."""


def fit(
    frames: FrameSplits, out: Path, recipes: Recipes, *, hard: FrameSplits | None = None,
    start: str | Path | None = None, resume: bool = False, watch: Watch | None = None,
    report: Callable[[str], Callable[[loop.TrainingReport], None]] | None = None, loaders: int = 0,
) -> Fitted:  # fmt: skip
    """Train on frames, and on hard ones at the last, judge by others, and write the nets into a folder; see `train`."""
    hard = hard or FrameSplits((), ())
    train_frames, val_frames = frames.train, frames.val
    digest = frames.digest + "".join(start_digests(start).values())
    for name, some in (("training", train_frames), ("validation", val_frames)):
        if not any(frame.labelled for frame in some):
            raise TrainingError(f"no {name} frame shows the grab; render more frames")
    step = watch or (lambda _: lambda _done, _total: None)
    follow = report or (lambda _: lambda _report: None)
    folder = out / "cache" / frames.digest[:16]

    small = [
        find.pictures(folder / f"small-{name}", some, step(f"resizing {name} images"))
        for name, some in (("train", train_frames), ("val", val_frames))
    ]
    trained: dict[str, loop.Trained] = {}

    def learn(name: str, build: Callable[[], torch.nn.Module], task: loop.Task, taken: str) -> torch.nn.Module:
        """Train a net."""
        if start is not None:
            build = functools.partial(_begun, build, Path(start) / f"{name}.onnx", task, taken)
        (out / name).mkdir(exist_ok=True)
        trained[name] = loop.train(
            build, task, getattr(recipes, name), out / name, data=digest, resume=resume, report=follow(name),
            loaders=loaders,
        )  # fmt: skip
        return trained[name].net

    found = learn("find", Find, find.CoarseTask(*small), "pictures")
    example = torch.zeros((1, FIND_HEIGHT, FIND_WIDTH, 3), dtype=torch.uint8)
    export.export(found, example, ["heat", "reach"], out / "find.onnx", {"task": FIND})

    key = _digest(out / "find.onnx")

    def cut(place: Path, name: str, some: Sequence[cache.TrainingFrame], pictures: find.SmallPictures) -> refine.Crops:
        boxes, progress = suspects(found, pictures, some), step(f"cutting {name} crops")
        return refine.crops(place / f"crops-{name}-{key}", some, boxes, seed=recipes.refine.seed, progress=progress)

    crops = [cut(folder, "train", train_frames, small[0]), cut(folder, "val", val_frames, small[1])]
    digest += key
    refined = learn("refine", Refine, refine.BoxTask(*crops), "crops")
    example = torch.zeros((1, REFINE_SIZE, REFINE_SIZE, 4), dtype=torch.uint8)
    export.export(refined, example, ["told"], out / "refine.onnx", {"task": REFINE})

    learned, judged = ([one] for one in crops)
    for name, some, sets in (("train", hard.train, learned), ("val", hard.val, judged)):
        if some:
            aside = folder.with_name(hard.digest[:16])
            pictures = find.pictures(aside / f"small-{name}", some, step(f"resizing hard {name} images"))
            sets.append(cut(aside, f"hard-{name}", some, pictures))
    digest += hard.digest + _digest(out / "refine.onnx")
    task = settle.PoseTask(learned, judged, refined)
    last = learn("settle", functools.partial(settle.learner, refined), task, "crops")
    write = functools.partial(export.export, last, example, ["told"])

    facts: dict[str, Any] = {"task": SETTLE}
    if start is not None and open_net(Path(start) / "settle.onnx").facts.get("verified") is True:
        facts["verified"] = True  # what verify goes by is the same for all grabs: it is taken over as it is
        export.copy(["verify"], Path(start), out)
    with scratch(out / "settle.onnx") as draft:  # a folder with settle.onnx in it is a detector, settings and all
        for name in ("find.onnx", "refine.onnx", *(["verify.onnx"] if "verified" in facts else [])):
            shutil.copyfile(out / name, draft / name)
        write(draft / "settle.onnx", facts)
        # Around find's box refine misses unfamiliar grabs by more than around its own.
        detector = GrabDetector(draft, Settings(least_presence=0.0, passes=PASSES, flips=WAYS))
    seen = evaluate.watch(detector, [*val_frames, *hard.val], step("detecting in val images"))
    others = evaluate.watch(detector, frames.real, step("detecting in real val images")) if frames.real else []
    first = GrabDetector(Path(start)) if start is not None else None
    least = first.settings.least_presence if first else 0.0
    fitted, figures = evaluate.calibrated(detector, seen, others, before=least)
    write(out / "settle.onnx", facts | fitted)
    if first:
        before = evaluate.watch(first, [*val_frames, *hard.val], step("detecting with the first weights"))
        figures["before"] = {key: value for key, value in evaluate.metrics(before).items() if key != "by_weather"}
    return Fitted(trained, figures)


def start_digests(start: str | Path | None) -> dict[str, str]:
    """SHA-256 of the nets that a training begins with, by name."""
    if start is None:
        return {}
    return {
        name: hashlib.sha256(read_bytes(Path(start) / f"{name}.onnx", TrainingError, most_bytes=MOST_BYTES)).hexdigest()
        for name in NETS
    }


def _begun(build: Callable[[], torch.nn.Module], path: Path, task: loop.Task, taken: str) -> torch.nn.Module:
    return begun(build, path, some_examples(task)[taken])


def _digest(path: Path) -> str:
    return sha256(path)[:16]


def suspects(
    net: torch.nn.Module, pictures: find.SmallPictures, frames: Sequence[cache.TrainingFrame]
) -> list[list[Array]]:
    """Boxes that find takes for the grab in each frame, px of the picture, the hottest first."""
    result = []
    with torch.inference_mode():
        for start in range(0, len(frames), _BATCH):
            some = torch.from_numpy(np.array(pictures.pictures[start : start + _BATCH]))
            heat, reach = (x.numpy() for x in net(some))
            for i, frame in enumerate(frames[start : start + _BATCH]):
                patch = whole(frame.row.width_px, frame.row.height_px)
                found = [box for box, score in peaks(heat[i], reach[i]) if score >= _SUSPECT]
                shares = [box.reshape(2, 2) / (FIND_WIDTH, FIND_HEIGHT) for box in found]
                result.append([patch.to_picture(corners).ravel() for corners in shares])
    return result

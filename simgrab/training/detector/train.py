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
from scipy.special import expit

from simgrab.dataset import datasets
from simgrab.errors import TrainingError
from simgrab.instrument.detect.grab import COARSE, POSE, GrabDetector, Settings, peaks
from simgrab.instrument.detect.patches import COARSE_HEIGHT, COARSE_WIDTH, POSE_CHANNELS, POSE_SIZE, whole
from simgrab.instrument.net import KEY, MOST_BYTES
from simgrab.io.files import scratch, sha256
from simgrab.io.parse import read_bytes
from simgrab.model.geometry import Array
from simgrab.training import loop
from simgrab.training.card import Card
from simgrab.training.detector import cache, coarse, evaluate, pose
from simgrab.training.detector.nets import Coarse, Pose, pretrained
from simgrab.training.detector.real import Real
from simgrab.training.detector.settings import Recipes
from simgrab.training.detector.start import begun, mix, some_examples
from simgrab.training.detector.trunk import TRUNK
from simgrab.training.device import named
from simgrab.training.export import export
from simgrab.training.folder import check, claim

_SUSPECT = 0.02  # heat from which on a place that is no grab makes a hard example
_BATCH = 32  # batch of the coarse net, pictures

NETS = ("coarse", "pose")
Follow = Callable[[str], Callable[[loop.TrainingReport], None]]
TASKS = {
    "coarse": f"Picture of {COARSE_WIDTH} x {COARSE_HEIGHT} in, heat at the centre of the grab's visible box and the "
    "distances to its edges out.",
    "pose": "Crop around a candidate's box, with its surroundings, in; whether it is the grab, its edges, centre and "
    "yaw, and how sure each is, out.",
}


def train(
    paths: Sequence[str | Path],
    out: str | Path,
    recipes: Callable[[int], Recipes],
    *,
    real: Real | None = None,
    start: str | Path | None = None,
    share: float = 1.0,
    resume: bool = False,
    watch: cache.Watch = lambda _: lambda _done, _total: None,
    report: Follow = lambda _: lambda _report: None,
    loaders: int = 0,
) -> dict[str, Any]:
    """Train the coarse net, and the pose net on what the coarse net takes for the grab; measure both together.

    Returns the detector's figures. Those of rendered validation frames and of real frames stand apart: the latter are
    ``real`` and ``real_…``.

    Parameters
    ----------
    paths : sequence of paths
        Datasets; frames of the split ``train`` are learned from, those of ``val`` judged by.
    out : path
        Gets two nets (`NETS`), their cards, checkpoints, and a cache of pictures that may be deleted.
    recipes : callable
        From the number of frames to learn from to the recipes.
    real : Real, optional
        Real frames: to learn from beside the others, to choose the presence threshold by, and to judge by.
    start : path, optional
        Folder of a trained detector whose weights the nets begin with, instead of those of ImageNet.
    share : float
        With ``start``, of the trained weights in those that are written; the rest are of ``start``. Figures of a net
        alone are of the trained ones.
    resume : bool
        Go on with an interrupted training of the same recipes and datasets.
    watch, report : callable
        Given the name of a step, return the callback of its progress.
    loaders : int
        Processes that make batches (`simgrab.training.loop.train`).

    Raises
    ------
    DatasetError, TrainingError
    """
    out = Path(out)
    check(out, resume=resume)
    began = start_digests(start)
    sets = datasets.read_all(paths, "train", "val")
    frames = FrameSplits.of(sets)
    rendered = len(frames.train)
    if real:
        frames = FrameSplits([*frames.train, *real.repeated(rendered)], frames.val, real.val)
    chosen = recipes(len(frames.train))
    named(chosen["coarse"].device)  # or refused before anything is written
    with claim(out, resume=resume):
        nets, metrics = _fit(
            frames, out, chosen, frames.digest + "".join(began.values()), None if start is None else Path(start), share,
            watch, report, functools.partial(loop.train, resume=resume, loaders=loaders),
        )  # fmt: skip
        if real:
            metrics |= real.figures(out, start, watch)
        for name, trained in nets.items():
            Card(
                name=name, task=TASKS[name], data=tuple(one.data for one in sets), examples=trained.examples,
                recipe=dataclasses.asdict(chosen[name]) | ({"share": share} if share < 1 else {}),
                epochs=trained.epochs, seconds=trained.seconds,
                metrics={"alone": trained.figures, "best_epoch": trained.epoch} | metrics,
                started_from=f"{TRUNK}, then a net of SHA-256 {began[name]}" if began else TRUNK,
                real=real.learned(rendered) if real else {},
            ).save(out / f"{name}.onnx")  # fmt: skip
    return metrics


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


def _fit(
    frames: FrameSplits, out: Path, recipes: Recipes, digest: str, start: Path | None, share: float, watch: cache.Watch,
    report: Follow, run: Callable[..., loop.Trained],
) -> tuple[dict[str, loop.Trained], dict[str, Any]]:  # fmt: skip
    """Train the nets and write them into a folder; returns them by name, and their figures together.

    With ``before``, those of the detector that they began with, where there is one.
    """
    for name, some in (("training", frames.train), ("validation", frames.val)):
        if not any(frame.labelled for frame in some):
            raise TrainingError(f"no {name} frame shows the grab; render more frames")
    folder = out / "cache" / frames.digest[:16]

    small = [
        coarse.pictures(folder / f"small-{name}", some, watch(f"resizing {name} images"))
        for name, some in (("train", frames.train), ("val", frames.val))
    ]
    trained: dict[str, loop.Trained] = {}

    def write(net: torch.nn.Module, example: torch.Tensor, outputs: list[str], path: Path, facts: Any) -> None:
        """Write a net's file, with its share of the trained weights."""
        export(net, example, "pictures", outputs, path, facts, key=KEY, halves=True)
        if start is not None and share < 1:
            mix(path, start / path.name, share)

    def learn(name: str, kind: type[Coarse | Pose], task: loop.Task, taken: str) -> torch.nn.Module:
        """Train a net."""
        build: Callable[[], torch.nn.Module] = functools.partial(pretrained, kind)
        if start is not None:
            build = functools.partial(begun, build, start / f"{name}.onnx", some_examples(task)[taken])
        (out / name).mkdir(exist_ok=True)
        trained[name] = run(build, task, recipes[name], out / name, data=digest, report=report(name))
        return trained[name].net

    found = learn("coarse", Coarse, coarse.CoarseTask(*small), "pictures")
    example = torch.zeros((1, COARSE_HEIGHT, COARSE_WIDTH, 3), dtype=torch.uint8)
    write(found, example, ["heat", "reach"], out / "coarse.onnx", {"task": COARSE})

    key = sha256(out / "coarse.onnx")[:16]
    crops = [
        pose.crops(
            folder / f"crops-{name}-{key}", some, suspects(found, pictures, some), seed=recipes["pose"].seed,
            progress=watch(f"cutting {name} crops"),
        )
        for name, some, pictures in (("train", frames.train, small[0]), ("val", frames.val, small[1]))
    ]  # fmt: skip
    digest += key
    last = learn("pose", Pose, pose.PoseTask(*crops), "crops")
    example = torch.zeros((1, POSE_SIZE, POSE_SIZE, POSE_CHANNELS), dtype=torch.uint8)
    write_pose = functools.partial(write, last, example, ["pose"])

    facts: dict[str, Any] = {"task": POSE}
    with scratch(out / "pose.onnx") as draft:  # a folder with pose.onnx in it is a detector, settings and all
        shutil.copyfile(out / "coarse.onnx", draft / "coarse.onnx")
        write_pose(draft / "pose.onnx", facts)
        detector = GrabDetector(draft, Settings(least_presence=0.0))
    seen = evaluate.watch(detector, frames.val, watch("detecting in val images"))
    others = evaluate.watch(detector, frames.real, watch("detecting in real val images")) if frames.real else []
    first = GrabDetector(start) if start is not None else None
    fitted, figures = evaluate.calibrated(detector, seen, others, before=first)
    write_pose(out / "pose.onnx", facts | fitted)
    if first:
        before = evaluate.watch(first, frames.val, watch("detecting with the first weights"))
        figures["before"] = {key: value for key, value in evaluate.metrics(before).items() if key != "by_weather"}
    return trained, figures


def start_digests(start: str | Path | None) -> dict[str, str]:
    """SHA-256 of the nets that a training begins with, by name."""
    if start is None:
        return {}
    return {
        name: hashlib.sha256(read_bytes(Path(start) / f"{name}.onnx", TrainingError, most_bytes=MOST_BYTES)).hexdigest()
        for name in NETS
    }


def suspects(
    net: torch.nn.Module, pictures: coarse.SmallPictures, frames: Sequence[cache.TrainingFrame]
) -> list[list[Array]]:
    """Boxes that the coarse net takes for the grab in each frame, px of the picture, the hottest first."""
    result = []
    with torch.inference_mode():
        for start in range(0, len(frames), _BATCH):
            some = torch.from_numpy(np.array(pictures.pictures[start : start + _BATCH]))
            heat, reach = (x.numpy() for x in net(some))
            for i, frame in enumerate(frames[start : start + _BATCH]):
                patch = whole(frame.row.width_px, frame.row.height_px)
                found = [box for box, logit in peaks(heat[i], reach[i]) if expit(logit) >= _SUSPECT]
                shares = [box.reshape(2, 2) / (COARSE_WIDTH, COARSE_HEIGHT) for box in found]
                result.append([patch.to_picture(corners).ravel() for corners in shares])
    return result

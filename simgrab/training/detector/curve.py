"""What a few real frames add: trainings with more and more of them, judged by the same real videos."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from simgrab._version import __version__
from simgrab.dataset import datasets
from simgrab.errors import TrainingError
from simgrab.io.parse import is_file, read_json
from simgrab.training.detector.cache import Watch
from simgrab.training.detector.real import Real, by_video, digest
from simgrab.training.detector.settings import Recipes
from simgrab.training.detector.train import Follow, FrameSplits, start_digests, train
from simgrab.training.folder import CURVE, check, claim, write

JSON, MARKDOWN = "learning-curve.json", "learning-curve.md"
_POINT = "point.json"


def learning_curve(
    paths: Sequence[str | Path],
    out: str | Path,
    recipes: Callable[[int], Recipes],
    real: Real,
    counts: Sequence[int],
    *,
    seed: int = 0,
    start: str | Path | None = None,
    resume: bool = False,
    watch: Watch = lambda _: lambda _done, _total: None,
    report: Follow = lambda _: lambda _report: None,
) -> list[dict[str, Any]]:
    """Train with some numbers of real frames, each time from the same weights, and judge by the same real videos.

    Parameters
    ----------
    paths, recipes, start, resume, watch, report
        As those of `simgrab.training.detector.train.train`.
    out : path
        Gets a folder ``real-N`` for each number, with a detector, and a table (`JSON`, `MARKDOWN`).
    real : Real
        Its validation frames are not used: real frames beyond those counted influence nothing.
    counts : sequence of int
        Numbers of frames to learn from; ``seed`` is that of their order: see `Real.some`.

    Returns
    -------
    list of dict
        For each number ``real_frames``, ``videos`` and ``figures``, as ``train`` gives them.

    Raises
    ------
    DatasetError, TrainingError
    """
    out = Path(out)
    check(out, resume=resume, traces=CURVE)
    parts = {count: real.some(count, seed) for count in counts}
    sets = datasets.read_all(paths, "train", "val")
    rendered = len(FrameSplits.of(sets).train)
    common = [__version__, datasets.digest(sets)]
    common += [*start_digests(start).values(), digest(real.held_out)]
    points = []
    with claim(out, resume=resume, traces=CURVE):
        for count, part in parts.items():
            folder, step, follow = out / f"real-{count}", _named(watch, count), _named(report, count)
            chosen = recipes(rendered + len(part.repeated(rendered)))
            recipe = {name: dataclasses.asdict(one) for name, one in chosen.items()}
            identity = hashlib.sha256(msgspec.json.encode([common, digest(part.train), recipe])).hexdigest()
            figures = _known(folder / _POINT, identity) if resume else None
            if figures is None:
                figures = train(
                    paths, folder, recipes, real=part, start=start, resume=resume, watch=step, report=follow
                )
                write(folder / _POINT, json.dumps({"identity": identity, "figures": figures}).encode())
                shutil.rmtree(folder / "cache", ignore_errors=True)
            points.append({"real_frames": count, "videos": len(by_video(part.train)), "figures": figures})
        write(out / JSON, f"{json.dumps(points, indent=1)}\n".encode())
        write(out / MARKDOWN, _markdown(points).encode())
    return points


def _known(path: Path, identity: str) -> dict[str, Any] | None:
    """Figures of a finished point; None where it is not finished."""
    if not is_file(path, TrainingError):
        return None
    content = read_json(path, TrainingError)
    if not isinstance(content, dict) or content.get("identity") != identity or "figures" not in content:
        raise TrainingError(f"{path} is of other frames, weights or settings: choose another --out")
    figures: dict[str, Any] = content["figures"]
    return figures


def _named(callback: Callable[[str], Any], count: int) -> Callable[[str], Any]:
    """Name the steps of one point."""
    return lambda name: callback(f"{name} ({count} real)")


def tables(points: Sequence[Mapping[str, Any]]) -> dict[str, list[tuple[str, ...]]]:
    """Tables by title, as text, each with its header: of held-out real frames, and of rendered validation frames."""
    real: list[tuple[str, ...]] = [("added", "videos", "recall", "mAP50-95", "false boxes")]
    rendered: list[tuple[str, ...]] = [("added", "recall", "mean IoU", "median centre error px")]
    for point in points:
        figures, count = point["figures"], str(point["real_frames"])
        held = figures["real"]
        false = f"{held['false_boxes']}/{held['empty']}{_interval(held['false_interval'])}"
        recall, precision = (_share(held[key], held[f"{key}_interval"]) for key in ("recall", "map50_95"))
        real.append((count, str(point["videos"]), recall, precision, false))
        rendered.append(
            (count, *(_share(figures[key]) for key in ("recall", "mean_iou")), _share(figures["centre_median_px"]))
        )
    held = points[0]["figures"]["real"]
    title = f"{held['frames']} held-out real frames of {held['videos']} videos, {held['labelled']} with a grab"
    return {title: real, "rendered validation frames": rendered}


def _share(value: float | None, interval: Sequence[float] | None = None) -> str:
    return "" if value is None else f"{value:.3f}{_interval(interval)}"


def _interval(interval: Sequence[float] | None) -> str:
    return "" if interval is None else f" ({interval[0]:.2f}-{interval[1]:.2f})"


def _markdown(points: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "# What real frames add",
        "",
        "In brackets: 95 % intervals, of recall and false boxes by frames (Clopper and Pearson), of mAP50-95 by "
        "resampled videos.",
    ]
    for title, (head, *rows) in tables(points).items():
        lines += ["", f"## {title[0].upper()}{title[1:]}", ""]
        lines += [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
    return "\n".join([*lines, ""])

"""Leave one kind of grabs out of the training: ``python -m scripts.left_out``.

Trains the default detector, which knows the four-rope grab alone, for a short time on random shapes over photographs
(`scripts.build_weights`): once on all kinds, and once on all but each. Each is scored on frames of the kind in worlds
that were used neither for training nor for choosing an epoch or a threshold. Writes ``left-out.json`` and prints a
table. What is done is kept and not done again. Needs ``simgrab[train]``.
"""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from scripts.background_photographs import prepare
from scripts.build_weights import BACKGROUNDS, MORE, ROOT, VERIFY, rendered
from simgrab._version import __version__
from simgrab.cli import main as run
from simgrab.cli._progress import board
from simgrab.errors import TrainingError
from simgrab.instrument.detect.bundled import WEIGHTS, Bundled
from simgrab.judge.evaluate import detection
from simgrab.labels import datasets
from simgrab.labels.truth import Row
from simgrab.training import need_torch
from simgrab.training.detector import cache, evaluate
from simgrab.training.detector.settings import recipes
from simgrab.training.detector.train import Frames, fit, start_digests
from simgrab.training.folder import claim, write

SPLITS = ("train", "val", "test")
KINDS = ("clamshell", "orange-peel")  # a part of the names that the scene gives to grabs
SHOWN = {"find": 12_000, "refine": 48_000, "settle": 8_000}
SCORED = next(source for source in VERIFY if source.name == "verify-photo")  # beside the split test of what is learned
RESULTS = "left-out.json"


def kind(frame: cache.Frame) -> str:
    """Which of `KINDS` hangs in a frame, or should; empty if it is another."""
    assert isinstance(frame.row, Row)
    name = str(json.loads(frame.row.varied)["grab"])
    return next((one for one in KINDS if one in name), "")


def trained(out: Path, left_out: str, sets: Sequence[datasets.Dataset], threads: int) -> Bundled:
    """Train on all frames but those of a kind."""
    some = Frames.of(sets)
    train, val = ([f for f in part if not left_out or kind(f) != left_out] for part in (some.train, some.val))
    frames = Frames(train, val)
    chosen = recipes(len(frames.train), shown=SHOWN, threads=threads)
    out.mkdir(parents=True, exist_ok=True)
    with board(shown=True) as progress:
        fit(
            frames, out, chosen, start=WEIGHTS, resume=True, watch=progress.step, report=progress.training,
        )  # fmt: skip
    shutil.rmtree(out / "cache")
    return Bundled(out)


def finished(path: Path, identity: str) -> dict[str, dict[str, Any]]:
    """Read what is done, by kind; refuses what other frames, weights or settings gave."""
    if not path.exists():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["identity"] != identity:
        raise TrainingError(f"{path} is of other frames, weights or settings: choose another --out")
    kinds: dict[str, dict[str, Any]] = content["kinds"]
    return kinds


def scores(looks: Bundled, frames: Sequence[cache.Frame]) -> dict[str, Any]:
    """Score a detector on frames of one kind."""
    cases = []
    for one in evaluate.watch(looks, frames):
        assert isinstance(one.frame.row, Row)
        cases.append(detection.Case(one.frame.row, one.frame.labelled, one.frame.weather, one.detection))
    result: dict[str, Any] = detection.score(cases)["overall"]
    return result


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--datasets", "work", type=click.Path(path_type=Path), help="[default: runs/weights]")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/left-out"), show_default=True)
@click.option("--workers", default=2, show_default=True, help="Processes that draw.")
@click.option("--threads", default=2, show_default=True, help="Of torch.")
def main(work: Path | None, out: Path, workers: int, threads: int) -> None:
    """Train, score and print."""
    need_torch()
    work = work or ROOT / "runs" / "weights"
    prepare(work / BACKGROUNDS)
    learned, others = (rendered(some, work, quick=False, workers=workers) for some in (MORE, [SCORED]))
    with claim(out, resume=True, traces=(RESULTS,)):
        sets, more = (datasets.read_all(some, *SPLITS) for some in (learned, others))
        scored = [*cache.frames(sets, "test"), *(frame for split in SPLITS for frame in cache.frames(more, split))]
        parts = [__version__, datasets.digest([*sets, *more]), *start_digests(WEIGHTS).values(), SHOWN]
        identity = hashlib.sha256(msgspec.json.encode(parts)).hexdigest()
        known = finished(out / RESULTS, identity)
        for left_out in ("", *KINDS):
            looks = functools.cache(functools.partial(trained, out / (left_out or "none"), left_out, sets, threads))
            for name in [left_out] if left_out else KINDS:
                entry = known.setdefault(name, {})
                if (key := "left out" if left_out else "learned") not in entry:
                    entry[key] = scores(looks(), [frame for frame in scored if kind(frame) == name])
                    write(out / RESULTS, json.dumps({"identity": identity, "kinds": known}, indent=1).encode())
    click.echo(table(known))


def table(known: dict[str, dict[str, Any]]) -> str:
    """Write a row for each kind, learned and left out."""
    lines = [
        "| kind | in training | frames | mAP50-95 | recall | grab centre: median, 95 % of the box's diagonal |",
        "|---|---|---|---|---|---|",
    ]
    for name, entry in known.items():
        for how, f in entry.items():
            low, high = f["recall_interval"]
            c = f["centre"]
            centre = f"{c['median_of_diagonal']:.1%}, {c['p95_of_diagonal']:.1%}" if c["frames"] else "–"
            lines.append(
                f"| {name} | {how} | {f['labelled']} | {f['map50_95']:.3f} "
                f"| {f['recall']:.1%} ({low:.1%} to {high:.1%}) "
                f"| {centre} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    run(main)

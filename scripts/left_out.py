"""Leave one kind of grabs out of the training: ``python -m scripts.left_out``.

Trains the bundled detector in a hurry, from its present weights, which know the four-rope grab alone, on random shapes
over photographs (`scripts.build_weights`): once on all kinds, and once on all but each. Judged is by frames of the kind
in worlds that were not learned. Writes ``left-out.json`` and prints a table. What is done is kept and not done again.
Needs ``simgrab[train]``.
"""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from scripts.background_photographs import prepare
from scripts.build_weights import BACKGROUNDS, MORE, ROOT, rendered
from simgrab.cli import main as run
from simgrab.cli._progress import board
from simgrab.instrument.detect.bundled import WEIGHTS, Bundled
from simgrab.judge.evaluate import detection
from simgrab.labels import datasets
from simgrab.labels.truth import Row
from simgrab.training import need_torch
from simgrab.training.detector import cache, evaluate
from simgrab.training.detector.settings import recipes
from simgrab.training.detector.train import Frames, fit
from simgrab.training.folder import claim, write

KINDS = ("clamshell", "orange-peel")  # a part of the names that the scene gives to grabs
SHOWN = {"find": 12_000, "refine": 48_000, "settle": 8_000}
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
    paths = rendered(MORE, work, quick=False, workers=workers)
    with claim(out, resume=True, traces=(RESULTS,)):
        kept = out / RESULTS
        known: dict[str, dict[str, Any]] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
        sets = datasets.read_all(paths, "train", "val", "test")
        judged = [frame for split in ("val", "test") for frame in cache.frames(sets, split)]
        for left_out in ("", *KINDS):
            looks = functools.cache(functools.partial(trained, out / (left_out or "none"), left_out, sets, threads))
            for name in [left_out] if left_out else KINDS:
                entry = known.setdefault(name, {})
                if (key := "left out" if left_out else "learned") not in entry:
                    entry[key] = scores(looks(), [frame for frame in judged if kind(frame) == name])
                    write(kept, json.dumps(known, indent=1).encode())
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

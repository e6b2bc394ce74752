"""Write ``docs/training-studies.md`` of what `scripts.training_studies` found: ``python -m scripts.training_page``.

``docs/training-studies.json`` keeps the figures; those found in ``--work`` take the place of those it has.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

import click
import numpy as np

from scripts.training_studies import (
    CROPS,
    EPOCHS,
    FINALS,
    LABELLED,
    OPTIMISERS,
    RATES,
    RESULTS,
    SHOWN,
    VIDEO,
    WORLDS,
    results,
)
from simgrab.cli import main as run
from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.training.folder import write as keep

PAGE = Path(__file__).parents[1] / "docs" / "training-studies.md"
RECORD = PAGE.with_suffix(".json")
NAMES = {"sgd": "SGD", "adam": "Adam"}
# mAP50-95 in %, from the paper's table: by rate, SGD and Adam, each by the last rate of OneCycle.
PAPER = {
    0.0005: (85.0, 84.6, 84.6, 93.1, 92.7, 92.6),
    0.001: (86.4, 87.2, 87.0, 93.8, 93.5, 93.4),
    0.005: (92.9, 92.6, 92.9, 91.7, 91.3, 92.0),
    0.01: (93.8, 94.5, 94.2, 90.1, 90.5, 90.5),
}


def page(known: dict[str, dict[str, Any]]) -> str:
    """Return the page of what `training_studies.results` gives; what was not studied is left out."""
    parts = [_head()]
    parts += [write(known[name]["found"]) for name, write in PARTS.items() if known.get(name, {}).get("found")]
    return "\n\n".join(parts) + "\n"


def _head() -> str:
    return f"""# The paper's trainings again, and what it could not see

Made by `python -m scripts.training_studies` and `python -m scripts.training_page`. The video is `{VIDEO.scene}`, seed
{VIDEO.seed}, one frame every {VIDEO.step_s:g} s: {LABELLED} frames, 80 % of them learned from and 20 % tested on, drawn
at random as in the paper. Ours begins from chance; the paper's YOLOv5 began from COCO. Every figure is of one
training."""


def _table(found: dict[str, float]) -> str:
    columns = [(optimiser, final) for optimiser in OPTIMISERS for final in FINALS]
    rows = [
        "| rate | " + " | ".join(f"{NAMES[o]} {f:g}" for o, f in columns) + " |",
        "|---" * (1 + len(columns)) + "|",
    ]
    for rate in RATES:
        cells = [
            f"{_percent(found.get(f'{optimiser} {rate:g} {final:g}'))} ({theirs:.1f})"
            for (optimiser, final), theirs in zip(columns, PAPER[rate], strict=True)
        ]
        rows.append(f"| {rate:g} | {' | '.join(cells)} |")
    best = max(found, key=lambda name: found[name])
    optimiser, highest, last = best.split()
    sgd, adam = (f"{_mean(found, one, RATES[0])} to {_mean(found, one, RATES[-1])} %" for one in OPTIMISERS)
    text = f"""
        Best: {_percent(found[best])} %, by {NAMES[optimiser]} at a highest rate of {highest} that ends at {last} of it.
        From the first row to the last SGD goes from {sgd}, Adam from {adam} (means of the three last rates; in the
        paper from 84.7 to 94.2 % and from 92.8 to 90.4 %)."""
    return f"""## Learning rates and optimisers

mAP50-95 in % of `find` alone (one net of a million weights, one look, {EPOCHS} epochs; rows: the highest rate of
OneCycle; columns: optimiser, and the last rate as a share of the highest), the paper's in brackets. The best epoch is
chosen on the tested frames, here by IoU and recall. Ours were measured before augmentation turned hues.

{_wrapped(text)}

""" + "\n".join(rows)


def _digits(found: dict[str, Any]) -> str:
    of = found["digits"]
    low, high = (100 * share for share in clopper_pearson(of["right"], of["tested"]) or (0, 1))
    return f"""## Digits

LeNet-5 on {CROPS} crops of that video, {CROPS - of["tested"]} learned from: {of["right"]} of {of["tested"]} test crops
read right (the paper: 64 of 64), the best epoch being chosen on them. So few tell little: the 95 % interval is
{low:.1f} to {high:.1f} %, and they stand at the same places of one video. `scripts/score_reader.py` reads 100,000."""


def _leak(found: dict[str, Any]) -> str:
    scores = found["leak"]
    rows = [f"| {name} | {_row(s)} |" for name, s in scores.items()]
    between, later = (_percent(scores[name]["map50_95"]) for name in ("frames in between", "later in the same video"))
    worst = min(scores, key=lambda name: float(scores[name]["map50_95"]))
    lowest, found_there = (_percent(scores[worst][key]) for key in ("map50_95", "recall"))
    text = f"""
        The whole detector, by the hurried recipe (`--quick`), learned from 80 % of the video's frames, an eighth of
        which choose the best epoch. The other 20 % lie between those, in the same light and before the same ground:
        there mAP50-95 is {between} %, on what comes after them in the same video {later} %. Neither tells of another
        weather or place; worst is "{worst}": mAP50-95 {lowest} %, recall {found_there} %. All frames show a grab, so
        none tests false boxes."""
    return f"""## What a random split of one video hides

{_wrapped(text)}

{HEAD}
""" + "\n".join(rows)


def _counts(found: dict[str, Any]) -> str:
    rows = [f"| {int(count):,} | {_row(found[count])} |" for count in sorted(found, key=int)]
    size, each = f"{WORLDS['camera.width_px']}×{WORLDS['camera.height_px']}", WORLDS["clip.clip_frames"]
    shown = ", ".join(f"{name} {examples:,}" for name, examples in SHOWN.items())
    fewest, most, best = min(found, key=int), max(found, key=int), max(found, key=lambda n: float(found[n]["map50_95"]))
    few, best_of_all, many = (_percent(found[n]["map50_95"]) for n in (fewest, best, most))
    text = f"""
        The whole detector, shown as many frames however many there are ({shown}: a hurried training), learned from
        frames of `scenes/training.toml` at {size}, {each} of each world, of which so many are taken evenly: while
        there are fewer frames than worlds each is of a world of its own, then come ever more of each. Frames of other
        worlds choose epochs and thresholds. Tested on {found[most]["frames"]:,} frames of worlds that none of these
        is of, but of the same scene: of a place, paint or camera beyond it they tell nothing. Differences of a per cent
        are within chance. mAP50-95 is {few} % with {int(fewest):,} frames, at its best {best_of_all} % with
        {int(best):,}, and {many} % with {int(most):,}: of {WORLDS["frames"] // each:,} worlds, test and validation
        among them, more frames of each teach little, at least in so short a training."""
    return f"""## How many frames

{_wrapped(text)}

{HEAD.replace("tested on", "frames learned from")}
""" + "\n".join(rows)


HEAD = """| tested on | mAP50-95 % | recall % | centre, median px | centre, 95 % px | false boxes |
|---|---|---|---|---|---|"""


def _wrapped(text: str) -> str:
    return textwrap.fill(" ".join(text.split()), 120)


def _row(s: dict[str, Any]) -> str:
    false = f"{s['false_boxes']} of {s['empty_frames']}" if s["empty_frames"] else "–"
    return " | ".join(
        [_percent(s["map50_95"]), _percent(s["recall"]), _px(s["centre_median_px"]), _px(s["centre_95_px"]), false]
    )


def _mean(found: dict[str, float], optimiser: str, rate: float) -> str:
    values = [value for name, value in found.items() if name.startswith(f"{optimiser} {rate:g} ")]
    return _percent(float(np.mean(values)) if values else None)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f}"


def _px(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


PARTS = {"table": _table, "digits": _digits, "leak": _leak, "counts": _counts}


@click.command()
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/training-studies"), show_default=True)
@click.option("--seed", default=0, show_default=True, help="Of the studies.")
def main(work: Path, seed: int) -> None:
    """Keep the figures, and write the page."""
    known = results(RECORD, seed)
    for name, study in results(work / RESULTS, seed).items():
        known.setdefault(name, study)["found"] |= study["found"]
    keep(RECORD, (json.dumps(known, indent=1) + "\n").encode())
    keep(PAGE, page(known).encode())


if __name__ == "__main__":
    run(main)

"""Write ``docs/results/training-studies.md``: ``python -m scripts.training_page``.

Its figures are the results of `scripts.training_studies`.

``docs/results/training-studies.json`` keeps the figures; those found in ``--work`` replace those it has.
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

PAGE = Path(__file__).parents[1] / "docs" / "results" / "training-studies.md"
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
    return f"""# What do the paper's training experiments show when they are repeated?

A test on randomly chosen frames of the training video shows nothing about other weather or places.
`python -m scripts.training_studies` trains, and `python -m scripts.training_page` writes this page.
`git log -p docs/results/training-studies.json` shows the commit and date of each figure.

The video is `{VIDEO.scene}`, seed {VIDEO.seed}, with one frame every {VIDEO.step_s:g} s. Of {LABELLED} frames, 80 % are
used for training and 20 % for testing, split at random as in the paper. The nets here start from random weights; the
paper's YOLOv5 started from COCO weights. Every figure is from one training."""


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
        The best value is {_percent(found[best])} %, with {NAMES[optimiser]}, a highest rate of {highest} and a last
        rate of {last} of it. The means over the three last rates change from the first row to the last: SGD from {sgd},
        Adam from {adam}. In the paper they change from 84.7 to 94.2 % and from 92.8 to 90.4 %."""
    return f"""## Learning rates and optimisers

The table gives mAP50-95 in %, with the paper's values in brackets. Only the net `find` is trained here: a million
weights, one pass over the image, {EPOCHS} epochs. Rows are the highest rate of OneCycle. Columns are the optimiser, and
the last rate as a share of the highest. The best epoch is chosen on the test frames, here by IoU and recall. These
values were measured before hue augmentation was added.

{_wrapped(text)}

""" + "\n".join(rows)


def _digits(found: dict[str, Any]) -> str:
    of = found["digits"]
    low, high = (100 * share for share in clopper_pearson(of["right"], of["tested"]) or (0, 1))
    return f"""## Digits

LeNet-5 was trained on {CROPS - of["tested"]} of {CROPS} crops of that video. It reads {of["right"]} of {of["tested"]}
test crops right (the paper: 64 of 64). The best epoch is chosen on them. So few crops prove little: the 95 % interval
is {low:.1f} to {high:.1f} %. They come from the same places in one video. `scripts/score_reader.py` reads 100,000."""


def _leak(found: dict[str, Any]) -> str:
    scores = found["leak"]
    rows = [f"| {name} | {_row(s)} |" for name, s in scores.items()]
    between, later = (_percent(scores[name]["map50_95"]) for name in ("frames in between", "later in the same video"))
    worst = min(scores, key=lambda name: float(scores[name]["map50_95"]))
    lowest, found_there = (_percent(scores[worst][key]) for key in ("map50_95", "recall"))
    text = f"""
        The whole detector was trained with `--quick` on 80 % of the video's frames. An eighth of them chooses the best
        epoch. The other 20 % lie between those frames, in the same light and in front of the same ground. There,
        mAP50-95 is {between} %. On later frames of the same video it is {later} %. Neither says anything about another
        weather or place. The worst case is "{worst}": mAP50-95 {lowest} %, recall {found_there} %. All frames show a
        grab, so none tests false boxes."""
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
        The whole detector was trained on frames of `scenes/training.toml` at {size}, with {each} frames in each world.
        A world is one random draw of everything that varies. Every row uses the same number of training examples
        ({shown}), as in a quick training. The frames of a row are taken evenly over the worlds. With fewer frames than
        worlds, every frame has a world of its own; with more, each world gives several. Frames of other worlds choose
        epochs and thresholds. The test uses {found[most]["frames"]:,} frames of unseen worlds, but of the same scene.
        It says nothing about places, paint or cameras that the scene lacks. Differences of one per cent are within
        chance. mAP50-95 is {few} % with {int(fewest):,} frames, {best_of_all} % at its best with {int(best):,}, and
        {many} % with {int(most):,}. There are {WORLDS["frames"] // each:,} worlds, test and validation included. More
        frames of each world improve little, at least in so short a training."""
    return f"""## How many frames

{_wrapped(text)}

{HEAD.replace("tested on", "training frames")}
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

"""Score a detector on datasets: ``scripts/python -m scripts.score_detector DATASET... [--detector …] [--json FILE]``.

Prints, overall, of grabs that the picture's edge cuts, and by weather: COCO mAP, recall and false boxes with their
intervals and in how many worlds any grab was missed or any box was false, the centre's error and bias with the box
centre's bias beside it, and how often stated intervals hold; then the centre by rope length, and the time. Datasets in
YOLO's or COCO's layout, such as of real frames, are scored apart by their boxes, overall and by video.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from simgrab.cli import main as run
from simgrab.cli._progress import bar
from simgrab.dataset import boxed, datasets
from simgrab.errors import DatasetError
from simgrab.instrument.detect import detector as opened
from simgrab.instrument.detect import pictures as detections
from simgrab.io.files import write
from simgrab.judge.evaluate import boxed as boxed_scores
from simgrab.judge.evaluate import detection
from simgrab.model.records import frame_files
from simgrab.model.records.observations import Detection
from simgrab.model.truth import Boxed
from simgrab.reports.terminal import cell

WIDTH = 120  # columns of text


def measure(
    paths: tuple[Path, ...], name: str, split: str | None, grab_classes: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Score a detector on rendered datasets together, and on those of boxes alone together."""
    looks, some, seconds = opened(name), list[detection.Case](), list[float]()

    def detected(path: Path, rows: Sequence[frame_files.PictureRow]) -> Sequence[Detection]:
        with bar(str(path), shown=True) as progress:
            watched = detections.detect_dataset(path, rows, looks, progress)
        seconds.extend(watched.seconds)
        return watched.detections

    rendered = [path for path in paths if frame_files.is_dataset(path)]
    others = boxed.read_all([path for path in paths if path not in rendered], grab_classes)
    for path in rendered:
        dataset = datasets.read(path)
        if split:
            dataset = dataset.split(split)
        elif any(row.split == "train" for row in dataset.rows):
            click.echo(f"{path}: frames of the split train are scored too; --split test leaves them out", err=True)
        some += detection.cases(dataset, detected(dataset.path, dataset.rows))
    rows, found = list[Boxed](), list[Detection]()
    for one in others:
        kept = one.split(split) if split else one
        rows += kept.rows
        found += detected(one.path, kept.rows)
    if not (some or rows):
        raise DatasetError(f"{', '.join(map(str, paths))}: no frames in the split {split!r}; render more frames")
    times = {"median_ms": 1e3 * float(np.median(seconds)), "p95_ms": 1e3 * float(np.quantile(seconds, 0.95))}
    return (
        {"detector": name, "datasets": [str(path) for path in paths], "time": times}
        | (detection.score(some) if some else {})
        | ({"real": boxed_scores.score(rows, found)} if rows else {})
    )


def show(scores: dict[str, Any]) -> None:
    """Print the tables."""
    console = Console(width=WIDTH)
    if "overall" in scores:
        groups = {
            "overall": scores["overall"], "half visible or more": scores["half_visible"],
            "cut off by the picture's edge": scores["cut_off"], **scores["by_weather"],
        }  # fmt: skip
        console.print(*boxes_tables(scores["detector"], groups), sep="\n")
        centres = {name: f["centre"] for name, f in groups.items()} | scores["by_rope"]
        console.print(*centres_tables(centres), sep="\n")
    if "real" in scores:
        console.print(_real(scores["detector"], scores["real"]))
    times = scores["time"]
    console.print(f"from array to detection: median {times['median_ms']:.1f} ms, 95 % {times['p95_ms']:.1f} ms")


def _table(title: str, columns: tuple[str, ...], caption: str | None = None) -> Table:
    table = Table(title=title, caption=caption)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left", no_wrap=i > 0)
    return table


def boxes_tables(name: str, groups: dict[str, Any]) -> list[Table]:
    """Show boxes of groups of frames, as `simgrab.judge.evaluate.detection.figures` gives them."""
    boxes = _table(
        f"{name}: boxes", ("", "grab", "mAP50-95", "mAP50", "recall", "empty", "false boxes"),
        "Worlds, not frames, are independent: true intervals of shares are wider. Standard errors are by worlds.",
    )  # fmt: skip
    worlds = _table(
        f"{name}: worlds, and the share of errors that stated 95 % intervals hold",
        ("", "worlds with one missed", "missed in a row", "worlds with a false box", "box", "centre", "yaw"),
    )
    for group, f in groups.items():
        boxes.add_row(
            group, str(f["labelled"]), _n(f["map50_95"]), _n(f["map50"]), _share(f["recall"], f["recall_interval"]),
            str(f["empty"]), f"{f['false_boxes']}{_interval(f['false_interval'])}",
        )  # fmt: skip
        worlds.add_row(
            group, f"{f['missed_worlds']}/{f['labelled_worlds']}", str(f["longest_miss"]),
            f"{f['false_worlds']}/{f['empty_worlds']}", *(_n(f["coverage"][key]) for key in ("box", "centre", "yaw")),
        )  # fmt: skip
    return [boxes, worlds]


def centres_tables(groups: dict[str, Any]) -> list[Table]:
    """Show the centre errors of groups of frames."""
    distances = _table(
        "grab centre: distance", ("", "frames", "width px", "median px", "95 % px", "median of diagonal", "95 %")
    )
    means = _table(
        "grab centre: signed means ± their standard error, and those of a perfect box's centre",
        ("", "u px", "v px", "outwards px", "%", "box px", "box %"),
    )
    for group, c in groups.items():
        if c["frames"]:
            distances.add_row(
                group, str(c["frames"]), _n(c["width_px"], 0), _n(c["median_px"], 2), _n(c["p95_px"], 2),
                f"{c['median_of_diagonal']:.2%}", f"{c['p95_of_diagonal']:.2%}",
            )  # fmt: skip
            means.add_row(
                group, *(f"{c[f'{k}_mean_px']:+.2f} ± {c[f'{k}_se_px']:.2f}" for k in ("u", "v", "radial")),
                f"{100 * c['radial_mean_share']:+.2f}", f"{c['box_radial_mean_px']:+.2f}",
                f"{100 * c['box_radial_mean_share']:+.2f}",
            )  # fmt: skip
    return [distances, means]


def _real(name: str, f: dict[str, Any]) -> Table:
    columns = ("", "frames", "grab", "mAP50-95", "mAP50", "recall", "empty", "false boxes")
    table = _table(f"{cell(name)}: boxes alone, of {f['videos']} videos", columns)
    precision = (_share(f["map50_95"], f["map50_95_interval"]), _n(f["map50"]))
    false = f"{f['false_boxes']}{_interval(f['false_interval'])}"
    table.add_row(
        "overall", str(f["frames"]), str(f["labelled"]), *precision, _share(f["recall"], f["recall_interval"]),
        str(f["empty"]), false,
    )  # fmt: skip
    for video, one in f["by_video"].items():
        hits = f"{one['hits']} of {one['labelled']}"
        table.add_row(
            cell(video), str(one["frames"]), str(one["labelled"]), "", "", hits, str(one["empty"]),
            str(one["false_boxes"]),
        )  # fmt: skip
    return table


def _n(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _share(value: float | None, interval: tuple[float, float] | None) -> str:
    return "" if value is None else f"{value:.4f}{_interval(interval)}"


def _interval(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else f" ({interval[0]:.4f}-{interval[1]:.4f})"


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--detector", default="bundled", show_default=True, help="Or a trained folder, or a YOLO's .onnx.")
@click.option("--split", type=click.Choice(["train", "val", "test"]), help="Only frames of one split.")
@click.option("--grab-class", "grab_classes", multiple=True, help="Class of YOLO's or COCO's boxes that is the grab.")
@click.option("--json", "out", type=click.Path(path_type=Path), help="Where all figures go.")
def main(
    paths: tuple[Path, ...], detector: str, split: str | None, grab_classes: tuple[str, ...], out: Path | None
) -> None:
    """Score a detector on datasets."""
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
    scores = measure(paths, detector, split, grab_classes)
    show(scores)
    if out:
        write(out, json.dumps(scores, indent=1) + "\n")


if __name__ == "__main__":
    run(main)

"""`simgrab detect`: where the grab is in pictures."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simgrab.cli._options import FILE, PATH, detector_option
from simgrab.text import printable

if TYPE_CHECKING:
    from simgrab.instrument.detect.pictures import Detections


@click.command(name="detect")
@click.argument("source", type=PATH)
@detector_option
@click.option("--out", type=FILE, help="Table of detections, .parquet or .csv.")
@click.option("--json", "as_json", is_flag=True, help="Print one line of JSON for each image: the row of the table.")
def command(source: Path, detector_name: str, out: Path | None, as_json: bool) -> None:
    """Detect the grab in SOURCE: an image, a folder of images, or a dataset.

    The table has u_px, v_px, which `simgrab estimate` reads. For a dataset it counts how many boxes its labels confirm;
    `scripts/python -m scripts.score_detector`, in a checkout, compares more.
    """
    from simgrab.cli._progress import bar
    from simgrab.instrument.detect import pictures as detections
    from simgrab.model.records import frame_files

    if out:
        detections.check_table(out)
    with bar("detecting", shown=not as_json and source.is_dir()) as progress:
        found = detections.detect(source, detector_name, progress)
    if found.note:
        click.echo(f"note: {found.note}", err=True)
    if as_json:
        for row in detections.rows(found):
            click.echo(json.dumps(row))
    else:
        count, median = sum(one.found for one in found.detections), statistics.median(found.seconds)
        images = f"{count} of {len(found.files)} images"
        click.echo(printable(f"{found.detector}: the grab in {images}, {1e3 * median:.1f} ms each"))
        if frame_files.is_dataset(source):
            click.echo(_against_labels(source, found))
    if out:
        detections.save(found, out)
        click.echo(printable(f"table: {out}"), err=as_json)


def _against_labels(path: Path, found: Detections) -> str:
    """Count detections that a dataset's labels confirm."""
    from simgrab.dataset import datasets
    from simgrab.judge.evaluate.detection import cases

    dataset, by_file = datasets.read(path), dict(zip(found.files, found.detections, strict=True))
    some = cases(dataset, [by_file[dataset.image(row)] for row in dataset.rows])
    right, labelled = sum(case.hit for case in some), sum(case.labelled for case in some)
    false, empty = sum(case.false for case in some), sum(case.empty for case in some)
    boxes = f"; boxes on {false} of {empty} images without one" if empty else ""
    return f"labels: {right} of {labelled} grabs in boxes of an IoU of 0.5 or more{boxes}"

"""`simgrab detect`: where the grab is in pictures."""

from __future__ import annotations

import json
import statistics
from pathlib import Path

import click

from simgrab.cli._options import FILE, PATH, detector_option
from simgrab.text import printable


@click.command(name="detect")
@click.argument("source", type=PATH)
@detector_option
@click.option("--out", type=FILE, help="Table of detections, .parquet or .csv.")
@click.option("--json", "as_json", is_flag=True, help="Print one line of JSON for each image: the row of the table.")
def command(source: Path, detector_name: str, out: Path | None, as_json: bool) -> None:
    """Detect the grab in SOURCE: an image, a folder of images, or a dataset.

    The table has u_px, v_px, which `simgrab estimate` reads. `python -m scripts.score_detector` compares with labels.
    """
    from simgrab.cli._progress import bar
    from simgrab.instrument.detect import pictures as detections

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
    if out:
        detections.save(found, out)
        click.echo(printable(f"table: {out}"), err=as_json)

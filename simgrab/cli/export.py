"""``simgrab export``."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.cli._options import FOLDER_OR_URL, PATH_OR_URL
from simgrab.cli._progress import bar
from simgrab.io.stores import is_url
from simgrab.text import printable

FORMATS = ("yolo", "yolo-pose", "yolo-seg", "yolo-obb", "coco", "voc", "webdataset", "hf", "simgrab")


@click.command(name="export")
@click.argument("dataset", type=PATH_OR_URL)
@click.option("--format", "layout", type=click.Choice(FORMATS), required=True, help="Layout to write.")
@click.option("--out", type=FOLDER_OR_URL, required=True, help="New folder, or URL below which there is nothing.")
@click.option(
    "--shard-frames", type=click.IntRange(1), help="Frames of each file, with webdataset and hf.  [default: 256]"
)
@click.option(
    "--leave-out-hidden",
    is_flag=True,
    help="Leave out frames that show some of the grab, but too little for a label.",
)
@click.option("--quiet", is_flag=True, help="Print errors only.")
def command(
    dataset: Path | str, layout: str, out: Path | str, shard_frames: int | None, leave_out_hidden: bool, quiet: bool
) -> None:
    """Write DATASET (a folder, or the URL of a dataset of shards) in the layout of another tool.

    yolo: images, text labels, data.yaml; -pose, -seg, -obb: with key points, polygons or oriented boxes. coco: images
    and JSON. voc: Pascal VOC's XML. webdataset: tar archives. hf: Parquet for Hugging Face datasets. simgrab: the
    folder that `simgrab render` writes.
    """
    from simgrab.dataset import shard_reader
    from simgrab.dataset.export import export
    from simgrab.dataset.summary import background
    from simgrab.dataset.yolo import stand_ins, straightened

    opened = shard_reader.open(dataset)
    with bar("exporting", shown=not quiet) as progress:
        summary = export(
            opened, out, format=layout, shard_frames=shard_frames, progress=progress, leave_out_hidden=leave_out_hidden
        )
    if quiet:
        return
    click.echo(printable(f"written: {out}"))
    lines = background(summary) if layout != "webdataset" else []
    if leave_out_hidden:
        left = len(opened) - summary.frames
        lines = [f"left out: {left} frames that show less of the grab than labels.least_visible_fraction"]
    lines += stand_ins([split for split, frames in summary.splits.items() if frames], layout)
    if layout == "yolo-obb" and not is_url(out):
        lines.append(straightened(Path(out)))
    for line in filter(None, lines):
        click.echo(line, err=True)

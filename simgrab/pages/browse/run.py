"""The folder of a run: its measurements as a table, with the truth beside them where its source is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgrab.dataset.datasets import Dataset, FolderFiles, FolderRows
from simgrab.dataset.tables import table_of
from simgrab.errors import DatasetError, PictureError, RunError, first_line
from simgrab.instrument.run import runs
from simgrab.instrument.run.runs import Run
from simgrab.instrument.source import PictureFiles, open_source
from simgrab.instrument.video import Video
from simgrab.io import files, parquet, pictures
from simgrab.io.parse import is_dir, is_file, read_bytes
from simgrab.judge.evaluate import truths
from simgrab.model.records import frame_files
from simgrab.pages.browse import columns, dataset
from simgrab.pages.browse.subject import Order, Subject
from simgrab.pages.browse.videos import VideoPictures

ANNOTATED = "annotated.mp4"
PREFIX = "true_"
ERRORS = {
    "abs_error_deg": ("deg", "absolute error of the swing angle"),
    "error_deg": ("deg", "measured minus true swing angle"),
    "centre_error_px": ("px", "distance of the measured grab centre from the true one"),
    "rope_error_m": ("m", "measured minus true rope length"),
}
SHOWN = (
    "abs_error_deg", "alpha_deg", "centre_error_px", "status", "score", "rope_error_m", "true_visible_fraction",
)  # fmt: skip
_UNTIMED_HZ = 9.0  # of an annotated video of independent frames


def open(path: Path, source: Path | None) -> Subject:
    """Open a run to browse it.

    Parameters
    ----------
    source : Path, optional
        The dataset, video or folder of pictures that the run measured. Unless given, a dataset that the run names and
        whose labels have the digest that it names.

    Raises
    ------
    RunError, DatasetError, SourceError
        If it is no run, or the source is not that of the run.
    """
    run = runs.load(path)
    if not run.measurements:
        raise RunError(f"{path}: the run has no frames")
    notes = [run.failure] if run.failure else []
    source = source or _named_dataset(run)
    if source is not None and is_dir(source, DatasetError):
        run = replace(run, measurements=())  # which take much memory, and are not needed
    table = _table(run, path)
    known = None if source is None else _known(run, source)
    labels, least, whole = known or (None, 0.0, None)
    if labels is None:
        notes.append("without the truth: give --source with the dataset or video that was measured to see errors")
    else:
        table = _with_truth(table, labels.table, least)
    order = Order("frame") if labels is None else Order("abs_error_deg", descending=True)
    size = run.calibration.width_px, run.calibration.height_px
    return Subject(
        str(path), "run", tuple(notes), table, order, (*SHOWN, *dataset.factors(table, PREFIX)), labels, whole,
        None if whole is not None else _pictures(run, path, source), size,
    )  # fmt: skip


def _table(run: Run, path: Path) -> pa.Table:
    """Read the table of a run that could be loaded."""
    schema = runs.table(replace(run, names=(), time=None, measurements=())).schema
    found = parquet.read_table(path / runs.TABLE, RunError, columns=schema.names)
    try:
        found = found.select(schema.names).cast(schema)
    except (pa.ArrowException, ValueError) as problem:
        raise RunError(f"{path / runs.TABLE}: not a table of a run ({first_line(problem)})") from None
    return found.set_column(0, schema.field("frame"), pa.array(np.arange(found.num_rows)))


def _named_dataset(run: Run) -> Path | None:
    """Find the dataset that a run names, where its labels are those of the run; any other path is not looked at."""
    digest = run.about.get("labels_sha256")
    path = Path(run.source)
    try:
        same = isinstance(digest, str) and is_file(path / frame_files.LABELS, DatasetError)
        return path if same and files.sha256(path / frame_files.LABELS) == digest else None
    except (DatasetError, OSError):
        return None


def _known(run: Run, source: Path) -> tuple[FolderRows, float, Dataset | None] | None:
    """Find the labels of a run's frames, with the least visible fraction at which boxes are labelled, and the dataset.

    None where the source has no truth, as a folder of pictures.
    """
    if is_dir(source, DatasetError):
        return _of_dataset(run, source) if frame_files.is_dataset(source) else None
    if not is_file(source.with_suffix(".parquet"), DatasetError):
        return None
    found = truths.of(run, source)
    return FolderRows(table_of(found.rows), FolderFiles(source, lambda _: None)), found.least_visible_fraction, None


def _of_dataset(run: Run, source: Path) -> tuple[FolderRows, float, Dataset]:
    labels, whole, _ = dataset.read(source)
    found = truths.match_names(run, labels.table["file"].to_pylist(), whole.data.labels_sha256, source)
    if None in found:
        raise RunError(f"{source}: contains none of the frames of the run on {run.source}")
    if found != list(range(len(labels))):
        labels = replace(labels, table=labels.table.take(pa.array(found)))
    return labels, whole.least_visible_fraction, whole


def _with_truth(table: pa.Table, labels: pa.Table, least: float) -> pa.Table:
    """Add errors, and the labels with `PREFIX` before their names."""

    def true(name: str) -> NDArray[np.float64]:
        return columns.numbers(labels[name])

    def measured(name: str) -> NDArray[np.float64]:
        return columns.numbers(table[name])

    present = labels["present"].fill_null(False).to_numpy().astype(bool)
    error = measured("alpha_deg") - np.where(present, true("alpha_deg"), np.nan)
    off = np.hypot(measured("u_px") - true("grab_u_px"), measured("v_px") - true("grab_v_px"))
    values = (np.abs(error), error, off, measured("rope_length_m") - true("rope_length_m"))
    for (name, (unit, text)), each in zip(ERRORS.items(), values, strict=True):
        table = table.append_column(dataset.field(name, pa.float64(), text, unit), pa.array(each, from_pandas=True))
    derived = dataset.with_derived(labels, least)
    for about, each in zip(derived.schema, derived.columns, strict=True):
        table = table.append_column(about.with_name(f"{PREFIX}{about.name}"), each)
    return table


def _pictures(run: Run, path: Path, source: Path | None) -> Callable[[int], bytes]:
    """Find where a run's pictures are: in its source, which is no dataset, or else in its annotated video."""
    if source is not None:
        opened = open_source(source)
        if isinstance(opened, Video) and run.time is not None:
            return VideoPictures(source, run.time.tolist()).content
        if isinstance(opened, PictureFiles):
            return _in_folder(opened, run.names)
        raise RunError(f"{source}: not the source of the run on {run.source}")
    if is_file(path / ANNOTATED, DatasetError):
        first = next((i for i, m in enumerate(run.measurements) if m.status != "lost"), 0)
        count = len(run.measurements)
        times = np.arange(count) / _UNTIMED_HZ if run.time is None else run.time
        return VideoPictures(path / ANNOTATED, (times - times[first]).tolist()).content

    def refuse(row: int) -> bytes:
        raise PictureError(f"row {row}", "the run has no annotated video; give --source with what was measured")

    return refuse


def _in_folder(source: PictureFiles, names: tuple[str, ...]) -> Callable[[int], bytes]:
    """Read pictures of a folder by the names that the run has for them, as they were measured."""
    known = {str(path.relative_to(source.root)): path for path in source.files}

    def content(row: int) -> bytes:
        path = known.get(names[row])
        if path is None:
            raise RunError(f"row {row}: the source has no picture of it")
        if source.bits:
            return pictures.encode(pictures.read(path, source.bits)[..., ::-1], "png")
        return read_bytes(path, RunError, most_bytes=pictures.MOST_BYTES)

    return content

"""Golden frames: pictures that must stay as they were recorded.

With the same renderer, packages and kind of CPU, their files must be the same to the byte. Otherwise edges and texture
filters differ a little everywhere, so similarity is judged tile by tile: the least mean SSIM (Wang, Bovik, Sheikh &
Simoncelli 2004) of 8 by 8 tiles. A mean over the whole picture would hardly change if the grab were missing. A frame of
`calm-day` keeps 0.89 with a coarser shadow map and 0.94 without multisampling; with the grab 9 px aside it keeps 0.12,
and with the grab's red and blue swapped 0.60.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from simgrab.dataset.datasets import MANIFEST, Dataset
from simgrab.errors import DatasetError, PictureError
from simgrab.io.parse import read_json
from simgrab.io.pictures import read as read_picture
from simgrab.io.strict import convert
from simgrab.judge.check.baseline import refusal
from simgrab.judge.check.verdicts import Status, Verdict
from simgrab.judge.doctor import cpu_features
from simgrab.model.truth import Row

FILE = "golden.json"
TILES = 8
Picture = NDArray[np.uint8]


class GoldenPicture(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A picture as it was recorded.

    Attributes
    ----------
    file : str
        File beside the list of golden frames.
    sha256 : str
        SHA-256 of the file.
    digest : str
        Digest of the scenario.
    drawn_by : str
        Digest of renderer and packages.
    """

    file: str
    sha256: str
    digest: str
    drawn_by: str


def keep(
    datasets: dict[str, Dataset], frames: dict[str, tuple[int, ...]]
) -> tuple[dict[str, GoldenPicture], dict[str, bytes]]:
    """Take golden frames from datasets: by ``SCENE/FRAME``, and the files to write beside them."""
    kept, files = {}, {}
    for name, dataset in datasets.items():
        for frame in frames[name]:
            path = dataset.image(_row(dataset, frame))
            file = f"{name}-{frame:06d}{path.suffix}"
            files[file] = path.read_bytes()
            sha256 = hashlib.sha256(files[file]).hexdigest()
            kept[f"{name}/{frame}"] = GoldenPicture(file, sha256, dataset.data.scenario_digest, drawn_by(dataset))
    return kept, files


def load(folder: Path) -> dict[str, GoldenPicture]:
    """Read the list of golden frames, empty if none was recorded yet; raises `SuiteError` for another file."""
    path = folder / FILE
    if not os.path.lexists(path):
        return {}
    listed = read_json(path, refusal, "golden frames")
    if not isinstance(listed, dict):
        raise refusal(f"{path}: must be a table of golden frames")
    return {name: convert(kept, GoldenPicture, refusal, f"{path}: {name}") for name, kept in listed.items()}


def look(name: str, frame: int, dataset: Dataset, folder: Path, least_ssim: float) -> tuple[Verdict, Picture | None]:
    """Compare a frame of a scene with its golden picture.

    Returns
    -------
    verdict : Verdict
        Its value is the SSIM of the least similar tile; None if the files are the same, or cannot be compared.
    difference : ndarray of uint8, shape (height, 3 width, 3), or None
        Golden picture, frame, and four times their difference, side by side, RGB; only if it failed.

    Raises `SuiteError` if the golden picture cannot be read.
    """

    def verdict(status: Status, message: str, ssim: float | None = None) -> Verdict:
        return Verdict(scene=name, what=f"golden frame {frame}", status=status, value=ssim, message=message)

    kept = load(folder).get(f"{name}/{frame}")
    row = _row(dataset, frame)
    if kept is None:
        return verdict("skipped", "not recorded yet"), None
    if kept.digest != (now := dataset.data.scenario_digest):
        why = f"out of date: recorded for the scenario {kept.digest[:12]}, and this is {now[:12]}"
        return verdict("failed", why), None
    if kept.sha256 == row.image_sha256:
        return verdict("passed", "the same to the byte"), None
    golden, picture = _read(folder / kept.file), _read(dataset.image(row))
    if golden.shape != picture.shape:
        return verdict("failed", f"of another size than recorded: {picture.shape} for {golden.shape}"), None
    least, beside = likeness(golden, picture), _beside(golden, picture)
    if kept.drawn_by == drawn_by(dataset):
        return verdict("failed", f"changed, although rendered by the same renderer (SSIM {least:.3f})", least), beside
    message = f"lowest SSIM of a tile {least:.3f}, at least {least_ssim:g} is required"
    if least < least_ssim:
        return verdict("failed", message, least), beside
    return verdict("passed", message, least), None


def likeness(a: Picture, b: Picture) -> float:
    """Least mean SSIM of 8 by 8 tiles of two pictures, each (height, width, 3)."""
    _, field = structural_similarity(  # type: ignore[no-untyped-call]
        a, b, channel_axis=2, data_range=255, full=True
    )
    small = np.asarray(field).mean(axis=2)
    rows = np.array_split(small, TILES, axis=0)
    return float(min(tile.mean() for row in rows for tile in np.array_split(row, TILES, axis=1)))


def drawn_by(dataset: Dataset) -> str:
    """Digest of the renderer and the packages that made a dataset, and of the vector units of this machine's CPU.

    NumPy computes differently on another kind of CPU, and the last bit of light may differ.
    """
    path = dataset.path / MANIFEST
    made = read_json(path, DatasetError)
    try:
        who = {"fingerprint": made["renderer"]["fingerprint"], "packages": made["packages"], "cpu": cpu_features()}
    except (LookupError, TypeError):
        raise DatasetError(f"{path} is not a simgrab manifest: it does not name the renderer") from None
    return hashlib.sha256(json.dumps(who, sort_keys=True).encode()).hexdigest()[:16]


def _row(dataset: Dataset, frame: int) -> Row:
    return next(row for row in dataset.rows if row.frame == frame)


def _read(path: Path) -> Picture:
    try:
        return read_picture(path)
    except PictureError as problem:
        raise refusal(str(problem)) from None


def _beside(golden: Picture, picture: Picture) -> Picture:
    apart = np.clip(4 * np.abs(golden.astype(np.int16) - picture), 0, 255).astype(np.uint8)
    return np.concatenate([golden, picture, apart], axis=1)

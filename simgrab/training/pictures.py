"""Pictures of a dataset, as training reads them: they must be those that the labels are of."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DatasetError
from simgrab.records import Truth


def picture(file: Path, row: Truth, mode: int = cv2.IMREAD_COLOR_RGB) -> NDArray[np.uint8]:
    """Decode the picture of a row.

    Parameters
    ----------
    file : Path
    row : Truth
    mode : int
        OpenCV's ``IMREAD_…``.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3), or (height, width) where ``mode`` is grey

    Raises
    ------
    DatasetError
        If it is damaged, or not the labels' picture.
    """
    try:
        data = file.read_bytes()
    except OSError as problem:
        raise DatasetError(f"{file} cannot be read: {problem.strerror or problem}") from None
    if hashlib.sha256(data).hexdigest() != row.image_sha256:
        raise DatasetError(f"{file} is not the picture that its labels are of: it was changed or damaged")
    found = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    if found is None:
        raise DatasetError(f"{file} is not a picture")
    return np.asarray(found, np.uint8)

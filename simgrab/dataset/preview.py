"""A contact sheet: frames with their labels drawn on them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.io import pictures
from simgrab.model import label_arrays as arrays
from simgrab.model.truth import KEYPOINT_NAMES, Row

if TYPE_CHECKING:
    from simgrab.dataset.datasets import Dataset

NAME = "preview.jpg"
TILE_WIDTH = 640
COLUMNS = 4
MOST_TILES = 16
CAPTION_HEIGHT = 24
BOX, CENTRE, VERTICAL = (60, 220, 60), (40, 40, 255), (255, 220, 60)
POINT, HIDDEN_POINT = (255, 90, 255), (170, 110, 170)


def tiles(dataset: Dataset) -> Iterator[tuple[NDArray[np.uint8], Row]]:
    """Frames of a dataset's sheet, BGR with their rows."""
    return ((frame.picture[..., ::-1], frame.truth) for frame in map(dataset.__getitem__, shown(len(dataset))))


def shown(frames: int) -> list[int]:
    """Choose the frames of a sheet, evenly among all, so that it shows what varies."""
    most = min(frames, MOST_TILES)
    return [i * frames // most for i in range(most)]


def annotate(picture: NDArray[np.uint8], row: Row) -> NDArray[np.uint8]:
    """Draw a row's labels on a copy of its picture (BGR), reduced to a tile of the sheet."""
    scale = TILE_WIDTH / row.width_px
    tile = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _draw_geometry(tile, row, scale)
    if (box := arrays.box(row)) is not None:
        cv2.rectangle(tile, at(box[:2], scale), at(box[2:], scale), BOX, 2, cv2.LINE_AA)
    for name, (u, v, seen) in zip(KEYPOINT_NAMES, np.reshape(row.keypoints, (-1, 3)), strict=True):
        if seen and name != "grab_centre":
            cv2.circle(tile, at((u, v), scale), 2, POINT if seen == 2 else HIDDEN_POINT, -1, cv2.LINE_AA)
    return captioned(tile, caption(row))


def caption(row: Row) -> str:
    """State a frame's angles and rope, and how much of the grab neither things nor weather hide."""
    name = f"#{row.frame} {row.split}"
    if not row.present:
        return f"{name}   no grab"
    angles = f"alpha {row.alpha_deg:.2f}  gamma {row.gamma_deg:.0f}  beta {row.beta_deg:.2f} deg"
    seen = row.visible_fraction * (1 - row.weather_hidden_fraction)
    return f"{name}   {angles}   rope {row.rope_length_m:.1f} m   seen {seen:.0%}"


def _draw_geometry(tile: NDArray[np.uint8], row: Row, scale: float) -> None:
    """Draw the principal point C', the image of the vertical G', the grab centre A', and the triangle they span."""
    vertical = arrays.vertical(row)
    principal = at((row.cx_px, row.cy_px), scale)
    cv2.drawMarker(tile, principal, VERTICAL, cv2.MARKER_CROSS, 14, 1, cv2.LINE_AA)
    if np.isfinite(vertical).all():
        cv2.line(tile, principal, at(vertical, scale), VERTICAL, 1, cv2.LINE_AA)
        cv2.circle(tile, at(vertical, scale), 4, VERTICAL, 1, cv2.LINE_AA)
    if row.present and row.grab_u_px is not None and row.grab_v_px is not None:
        centre = at((row.grab_u_px, row.grab_v_px), scale)
        if np.isfinite(vertical).all():
            cv2.line(tile, at(vertical, scale), centre, CENTRE, 1, cv2.LINE_AA)
        cv2.drawMarker(tile, centre, CENTRE, cv2.MARKER_TILTED_CROSS, 12, 2, cv2.LINE_AA)


def at(pixel: Sequence[float] | NDArray[np.float64], scale: float) -> tuple[int, int]:
    """Place a pixel of the picture in a reduced one, for OpenCV, which counts from the centre of the first pixel."""
    return tuple(int(np.clip(round(float(v) * scale - 0.5), -9999, 9999)) for v in pixel)  # type: ignore[return-value]


def captioned(tile: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """Return the tile with a line of text on a strip below it."""
    strip = np.full((CAPTION_HEIGHT, tile.shape[1], 3), 24, np.uint8)
    cv2.putText(strip, text, (8, CAPTION_HEIGHT - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return np.vstack([tile, strip])


def of(frames: Iterable[tuple[NDArray[np.uint8], Row]]) -> bytes:
    """Make the contact sheet of frames, BGR with their rows, as JPEG."""
    return pictures.encode(sheet([annotate(picture, row) for picture, row in frames]), "jpeg", 90)


def sheet(tiles: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Lay tiles out in rows of four."""
    columns = min(COLUMNS, len(tiles))
    blank = np.zeros_like(tiles[0])
    padded = [*tiles, *[blank] * (-len(tiles) % columns)]
    return np.vstack([np.hstack(padded[i : i + columns]) for i in range(0, len(padded), columns)])

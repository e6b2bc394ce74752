"""What is rendered of one moment, before the camera's effects: rgb, ids, depth and silhouette."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.world.camera.lens import Window
from simgrab.world.camera.renderer import Renderer, View
from simgrab.world.projection import Projection
from simgrab.world.scenery.model import GRAB


@dataclass(frozen=True, eq=False)
class Visibility:
    """How much of the grab one frame shows.

    Attributes
    ----------
    visible : View
        Ids and depth in the part of the projection's window that lies in the picture.
    visible_fraction, in_frame_fraction : float
        See `simgrab.model.truth.Truth`.
    """

    visible: View
    visible_fraction: float
    in_frame_fraction: float

    @property
    def box(self) -> Window | None:
        """Tight box of the visible grab in the picture, half open."""
        mask = self.visible.shows_grab
        if not mask.any():
            return None
        x, y = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
        x0, y0 = self.visible.window[:2]
        return x0 + int(x[0]), y0 + int(y[0]), x0 + int(x[-1]) + 1, y0 + int(y[-1]) + 1


NONE_VISIBLE = Visibility(View((0, 0, 0, 0), np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.float32)), 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Buffers:
    """What is rendered of one moment.

    Attributes
    ----------
    projection : Projection
        Of the moment.
    rgb : ndarray, shape (height, width, 3)
        uint8, sRGB, of one instant; or float32, linear light averaged over each row's exposure.
    visibility : Visibility
    full : View or None
        Ids and depth of the whole picture, as finely as labels need them, where they are wanted.
    view : View or None
        Ids and depth of the whole picture, where weather or lamps need them; a lens may move edges by half a pixel.
    """

    projection: Projection
    rgb: NDArray[Any]
    visibility: Visibility
    full: View | None
    view: View | None


def observe(renderer: Renderer, projection: Projection, full: View | None = None) -> Visibility:
    """Render the grab alone, for its whole silhouette, and among everything else, for what is visible of it.

    ``full`` is a view of the whole picture, where one was rendered already.
    """
    k, moment = renderer.intrinsics, projection.moment
    x0, y0, x1, y1 = projection.window
    inner = max(x0, 0), max(y0, 0), min(x1, k.width_px), min(y1, k.height_px)
    if not projection.meets(k.width_px, k.height_px):
        return NONE_VISIBLE
    if full is None and inner == projection.window:
        whole, visible = renderer.grab_views(moment, inner)
    else:
        whole = renderer.silhouette(moment, projection.window)
        visible = full.crop(inner) if full else renderer.view(moment, inner)
    total = max(int(whole.sum()), 1)
    inside = whole[inner[1] - y0 : inner[3] - y0, inner[0] - x0 : inner[2] - x0]
    return Visibility(visible, int((visible.ids == GRAB).sum()) / total, int(inside.sum()) / total)

"""What every second renderer offers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.world.camera.lens import Window

Shapes = Mapping[str, tuple[Array, NDArray[np.int64]]]


class SecondRenderer(Protocol):
    """Renders silhouettes of posed shapes. The constructor raises `RendererError` where it cannot render here."""

    package: str  # the package that it needs
    name: str  # what it is, with the version

    def __init__(self) -> None: ...

    def load(self, shapes: Shapes) -> None:
        """Replace the shapes.

        Parameters
        ----------
        shapes : dict of str to (vertices (V, 3), faces (F, 3))
            Each in its own frame, m.
        """
        ...

    def silhouette(
        self, camera_from_shape: Mapping[str, Array], f: float, cx: float, cy: float, window: Window, supersampling: int
    ) -> NDArray[np.bool_]:
        """Render loaded shapes through a window of an undistorted picture, one sample at the centre of each cell.

        Parameters
        ----------
        camera_from_shape : dict of str to ndarray, shape (4, 4)
            OpenCV camera frame. Shapes left out are not rendered.
        f, cx, cy : float
            Focal length and principal point, px; (0, 0) is the outer corner of the top-left pixel.
        window : tuple of 4 ints
            x0, y0, x1, y1, px, half open.
        supersampling : int
            Samples a pixel and direction.

        Returns
        -------
        ndarray of bool, shape ((y1 − y0)·supersampling, (x1 − x0)·supersampling)

        Raises
        ------
        RendererError
            If the renderer ended meanwhile.
        """
        ...

    def close(self) -> None:
        """Free what the renderer holds."""
        ...

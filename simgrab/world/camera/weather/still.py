"""What weather does to what stands still, kept from frame to frame.

Depth and ids alone decide how wet, how white and how hazy a surface is. While camera and crane stand still, most pixels
show the same surfaces in every frame, so only those near what differs are worked out again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simgrab.world.camera import changes
from simgrab.world.camera.lens import Window
from simgrab.world.camera.row_blocks import ROWS, threaded_map
from simgrab.world.camera.weather.render_pass import Picture, RenderPass

APART_PX = 10_000.0  # a window more costs as much as so many pixels

At = tuple[slice, slice]  # rows and columns of a picture
Fields = tuple[Picture, ...]  # of one shape
Maker = Callable[[RenderPass, At], Fields]


@dataclass(frozen=True, eq=False)
class Still:
    """Depth and ids of what stands still, and what was made of them.

    Attributes
    ----------
    depth : ndarray of float32, shape (height, width)
        Along the optical axis, m.
    ids : ndarray of uint8, shape (height, width)
    made : dict of str to tuple of ndarray
        Fields by name. One picture's settings, pose and lamps are those of all others.
    """

    depth: Picture
    ids: NDArray[np.uint8]
    made: dict[str, Fields] = field(default_factory=dict)


class Seen:
    """A rendered picture beside what stands still in it.

    Parameters
    ----------
    rendered : RenderPass
    still : Still, optional
        Without it everything is worked out.
    """

    def __init__(self, rendered: RenderPass, still: Still | None = None) -> None:
        self.rendered, self._still = rendered, still
        self._windows: list[Window] | None = None

    def fields(self, name: str, make: Maker, step: int = 1, *, keep: bool = True) -> Fields:
        """Make fields, whole or, where something stands still, over those that were kept.

        Parameters
        ----------
        name : str
            Under which they are kept.
        make : callable
            Takes a render pass, and rows and columns of fields of every ``step``-th pixel; returns these. They depend
            on nothing in a frame but its depth and ids, each value on those within `changes.CELL_PX`.
        step : int
        keep : bool
            Whether they may be kept at all.
        """
        if self._still is None or not keep:
            return _whole(self.rendered, make, step)
        if name not in self._still.made:
            bare = replace(self.rendered, depth=self._still.depth, ids=self._still.ids)
            self._still.made[name] = _whole(bare, make, step)
        result = tuple(kept.copy() for kept in self._still.made[name])

        def renew(window: Window) -> None:
            x0, y0, x1, y1 = window
            at = slice(y0 // step, -(-y1 // step)), slice(x0 // step, -(-x1 // step))
            for kept, new in zip(result, make(self.rendered, at), strict=True):
                kept[at] = new

        threaded_map(renew, self._changed())
        return result

    def _changed(self) -> Sequence[Window]:
        """Windows that hold all pixels whose fields may differ from those kept."""
        if self._windows is None:
            assert self._still is not None
            differs = self.rendered.depth != self._still.depth
            differs |= self.rendered.ids != self._still.ids
            grid = changes.tiles_near(differs)
            height, width = differs.shape
            self._windows = changes.windows(grid, width, height, APART_PX)
        return self._windows


def _whole(rendered: RenderPass, make: Maker, step: int) -> Fields:
    height, width = (-(-n // step) for n in rendered.depth.shape)
    blocks = [(slice(y, min(y + ROWS, height)), slice(0, width)) for y in range(0, height, ROWS)]
    parts = threaded_map(partial(make, rendered), blocks)
    return tuple(np.concatenate(of_one) for of_one in zip(*parts, strict=True))

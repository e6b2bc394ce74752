"""Check the grab's position: a second renderer renders the grab alone, from the stored poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError
from simgrab.judge.audit.proof import Findings, Proof
from simgrab.judge.audit.second_renderer import SecondRenderer, Shapes, open_second_renderer
from simgrab.model.geometry import Array
from simgrab.model.truth import Truth
from simgrab.world.camera.lens import Window
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.plan import placed_shapes

EDGE_TOLERANCE_PX = 0.5
CENTROID_TOLERANCE_PX = 0.2
LEAST_IOU = 0.98
MOST_SAMPLES = 5000  # a side of the supersampled picture
CLAIM = "a second renderer renders the same silhouette"

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Difference:
    """Difference of two silhouettes."""

    edge_px: float  # the largest distance between edges of their boxes; infinite where one is empty
    iou: float
    centroid_px: float  # distance of the centroids: the larger one of the two coordinates

    @classmethod
    def of(cls, a: Mask, b: Mask, window: Window) -> Difference:
        """Compare two masks of one size.

        Parameters
        ----------
        a, b : ndarray of bool, shape (h, w)
            Supersampled silhouettes.
        window : tuple of 4 ints
            x0, y0, x1, y1 of both, px.
        """
        iou = float((a & b).sum() / max((a | b).sum(), 1))
        edge = np.nan_to_num(np.abs(_box(a, window) - _box(b, window)), nan=np.inf).max()
        return cls(float(edge), iou, float(np.abs(_centroid(a, window) - _centroid(b, window)).max()))

    def worst(self, other: Difference) -> Difference:
        """Combine two differences: the larger value of each field."""
        return Difference(
            max(self.edge_px, other.edge_px), min(self.iou, other.iou), max(self.centroid_px, other.centroid_px)
        )

    def __str__(self) -> str:
        return f"worst edge {self.edge_px:.2f} px, IoU {self.iou:.4f}, centroid {self.centroid_px:.3f} px"


NONE = Difference(0.0, 1.0, 0.0)


def compare(rows: Sequence[Truth], generator: FrameGenerator, tick: Iterable[None]) -> Proof:
    """Compare every row's amodal box, and the silhouette that MuJoCo renders, with the second renderer's.

    Shapes and MuJoCo's silhouettes are of the generator of the dataset's scenario; ``tick`` is advanced once a row.
    """
    found, worst = Findings(), NONE
    try:
        with open_second_renderer() as (renderer, note):
            for _, group in groupby(
                zip(rows, tick, strict=False), lambda row: generator.recipe.variant_number(row[0].frame)
            ):
                seen = [row for row, _ in group if row.in_frame_fraction > 0]
                if seen:
                    renderer.load(grab_shapes(generator, seen[0].frame))
                for row in seen:
                    worst = worst.worst(_compare(row, generator, renderer, found))
    except RendererError as problem:
        return Proof(CLAIM, 0, note=str(problem))
    return found.proof(CLAIM, f"{worst}; {note}", renderer.name)


def grab_shapes(generator: FrameGenerator, frame: int) -> Shapes:
    """Vertices and faces of all shapes that the grab of a frame's variant may show."""
    meshes = generator.scene(frame).world.plan.shapes
    return {name: (np.array(m.vertices), np.array(m.faces)) for name, m in meshes.items()}


def _compare(row: Truth, generator: FrameGenerator, other: SecondRenderer, found: Findings) -> Difference:
    renderer, projection = generator.scene(row.frame).renderer, generator.project(row.frame)
    window = projection.window
    samples = samples_a_pixel(window)
    # At one sample a pixel, an edge that lies along the samples of a row would move the whole row.
    ours = renderer.silhouette(projection.moment, window, samples)
    theirs = silhouette(other, generator.scene(row.frame).world.plan.grab, row, window, samples)
    edge = 0.0
    for column, value in zip(("x0", "y0", "x1", "y1"), _box(theirs, window), strict=True):
        stored = getattr(row, f"amodal_{column}_px")
        edge = max(edge, abs(stored - value))
        found.expect(
            abs(stored - value) <= EDGE_TOLERANCE_PX, f"frame {row.frame}, amodal_{column}_px",
            f"{stored:.2f} px, but the second renderer's edge is at {value:.2f} px",
        )  # fmt: skip
    apart = replace(Difference.of(ours, theirs, window), edge_px=edge)
    where = f"frame {row.frame}, silhouette"
    found.expect(apart.iou >= LEAST_IOU, where, f"IoU {apart.iou:.4f} < {LEAST_IOU}")
    found.expect(apart.centroid_px <= CENTROID_TOLERANCE_PX, where, f"centroid {apart.centroid_px:.2f} px apart")
    return apart


def samples_a_pixel(window: Window) -> int:
    """Return the samples a pixel and direction."""
    longest = max(window[2] - window[0], window[3] - window[1])
    return next((s for s in (5, 3) if s * longest <= MOST_SAMPLES), 1)


def silhouette(other: SecondRenderer, grab: Design, row: Truth, window: Window, samples: int) -> Mask:
    """Render a grab from a row's poses through a window of the lens' picture, supersampled."""
    source, maps = _source(row, window)
    camera_from_jib = np.linalg.inv(_square(row.jib_from_camera))
    camera_from_grab = camera_from_jib @ _square(row.jib_from_grab)
    shapes = placed_shapes(grab, float(np.radians(row.jaw_deg)), row.load)
    placed = {name: camera_from_grab @ at for name, at in shapes.items()}
    mask = other.silhouette(placed, row.fx_px, row.cx_px, row.cy_px, source, samples)
    if maps is not None:
        x0, y0, x1, y1 = window
        fine = cv2.resize(maps, ((x1 - x0) * samples, (y1 - y0) * samples), interpolation=cv2.INTER_LINEAR)
        at = ((fine - source[:2]) * samples - 0.5).astype(np.float32)
        mask = cv2.remap(mask.astype(np.uint8), at, None, cv2.INTER_NEAREST) > 0
    return mask


def _source(row: Truth, window: Window) -> tuple[Window, Array | None]:
    """Window of the undistorted picture behind a window of the lens' picture, and where each pixel comes from."""
    lens = np.array((row.k1, row.k2, row.p1, row.p2, row.k3))
    if not lens.any():
        return window, None
    x0, y0, x1, y1 = window
    grid = np.stack(np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5), axis=-1)
    K = np.array([[row.fx_px, 0, row.cx_px], [0, row.fy_px, row.cy_px], [0, 0, 1]])
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    ideal = cv2.undistortPoints(grid.reshape(-1, 1, 2), K, lens, None, None, K, stop).reshape(grid.shape)
    low, high = np.floor(ideal.min((0, 1))).astype(int) - 2, np.ceil(ideal.max((0, 1))).astype(int) + 2
    return (int(low[0]), int(low[1]), int(high[0]), int(high[1])), ideal


def _box(mask: Mask, window: Window) -> Array:
    """Edges of a supersampled mask, px."""
    samples = mask.shape[1] / (window[2] - window[0])
    x, y = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not x.size:
        return np.full(4, np.nan)
    edges = np.array([x[0], y[0], x[-1] + 1, y[-1] + 1]) / samples
    return np.asarray(edges + (window[0], window[1], window[0], window[1]))


def _centroid(mask: Mask, window: Window) -> Array:
    """Centroid of a supersampled mask from the corner of its window, px."""
    samples = mask.shape[1] / (window[2] - window[0])
    y, x = np.nonzero(mask)
    return np.array([x.sum(), y.sum()]) / (max(x.size, 1) * samples)


def _square(pose: Sequence[float]) -> Array:
    return np.vstack([np.reshape(pose, (3, 4)), (0.0, 0.0, 0.0, 1.0)])

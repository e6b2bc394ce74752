"""Is the grab where its labels say? A second renderer draws it alone, from the stored poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError
from simgrab.judge.proof import Findings, Proof
from simgrab.records import Truth
from simgrab.world import second_opinion
from simgrab.world.frames import Studio
from simgrab.world.lens import Window
from simgrab.world.plan import placed_shapes
from simgrab.world.second_opinion import SecondOpinion

EDGE_TOLERANCE_PX = 0.5
CENTROID_TOLERANCE_PX = 0.2
LEAST_IOU = 0.98
MOST_SAMPLES = 5000  # a side of the supersampled picture
CLAIM = "a second renderer draws the same silhouette"

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def compare(rows: Sequence[Truth], studio: Studio, tick: Iterable[None]) -> Proof:
    """Compare every row's amodal box, and the silhouette that MuJoCo draws, with pyrender's.

    Parameters
    ----------
    rows : sequence of Truth
    studio : Studio
        Of the dataset's scenario; it lends the shapes and draws MuJoCo's silhouettes.
    tick : iterable
        Advanced once a row.
    """
    if not second_opinion.available():
        return Proof(CLAIM, 0, note=f"pyrender is not installed: {second_opinion.INSTALL_HINT}")
    found = Findings()
    worst = (0.0, 1.0, 0.0)
    try:
        for _, group in groupby(
            zip(rows, tick, strict=False), lambda row: studio.scenario.variant_number(row[0].frame)
        ):
            seen = [row for row, _ in group if row.in_frame_fraction > 0]
            if seen:
                edge, iou, centroid = _compare(seen, studio, found)
                worst = max(edge, worst[0]), min(iou, worst[1]), max(centroid, worst[2])
    except RendererError as problem:
        return Proof(CLAIM, 0, note=str(problem))
    edge, iou, centroid = worst
    return found.proof(CLAIM, f"worst edge {edge:.2f} px, IoU {iou:.4f}, centroid {centroid:.3f} px")


def _compare(rows: Sequence[Truth], studio: Studio, found: Findings) -> tuple[float, float, float]:
    """Compare rows of one variant; gives the worst edge, px, IoU and centroid, px."""
    edge, iou, centroid = 0.0, 1.0, 0.0
    meshes = studio.at(rows[0].frame).world.plan.shapes
    with SecondOpinion({name: (np.array(m.vertices), np.array(m.faces)) for name, m in meshes.items()}) as other:
        for row in rows:
            aimed = studio.aim(row.frame)
            samples = _samples(aimed.window)
            # At one sample a pixel, an edge that lies along the samples of a row would move the whole row.
            ours, theirs = studio.renderer.silhouette(aimed.window, samples), _draw(other, row, aimed.window, samples)
            for column, value in zip(("x0", "y0", "x1", "y1"), _box(theirs, aimed.window), strict=True):
                stored = getattr(row, f"amodal_{column}_px")
                edge = max(edge, abs(stored - value))
                found.expect(
                    abs(stored - value) <= EDGE_TOLERANCE_PX, f"frame {row.frame}, amodal_{column}_px",
                    f"{stored:.2f} px, but the second renderer's edge is at {value:.2f} px",
                )  # fmt: skip
            overlap = float((ours & theirs).sum() / max((ours | theirs).sum(), 1))
            shift = float(np.abs(_centroid(ours) - _centroid(theirs)).max()) / samples
            iou, centroid = min(iou, overlap), max(centroid, shift)
            found.expect(overlap >= LEAST_IOU, f"frame {row.frame}, silhouette", f"IoU {overlap:.4f} < {LEAST_IOU}")
            found.expect(
                shift <= CENTROID_TOLERANCE_PX, f"frame {row.frame}, silhouette", f"centroid {shift:.2f} px apart"
            )
    return edge, iou, centroid


def _samples(window: Window) -> int:
    """Return the samples a pixel and direction."""
    longest = max(window[2] - window[0], window[3] - window[1])
    return next((s for s in (5, 3) if s * longest <= MOST_SAMPLES), 1)


def _draw(other: SecondOpinion, row: Truth, window: Window, samples: int) -> Mask:
    """Silhouette through a window of the lens' picture, supersampled."""
    source, maps = _source(row, window)
    camera_from_jib = np.linalg.inv(_square(row.jib_from_camera))
    camera_from_grab = camera_from_jib @ _square(row.jib_from_grab)
    shapes = placed_shapes(float(np.radians(row.jaw_deg)), row.load)
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


def _centroid(mask: Mask) -> Array:
    total = max(int(mask.sum()), 1)
    y, x = np.nonzero(mask)
    return np.array([x.sum(), y.sum()]) / total


def _square(pose: Sequence[float]) -> Array:
    return np.vstack([np.reshape(pose, (3, 4)), (0.0, 0.0, 0.0, 1.0)])

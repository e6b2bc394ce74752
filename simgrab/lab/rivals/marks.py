"""Rivals that measure with marks on the grab, after Wu, Matsuo, and those who use fiducials."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from simgrab.errors import CalibrationError
from simgrab.instrument.contract import Frame, Measurement, Picture
from simgrab.lab.rivals.contract import Series
from simgrab.lab.rivals.inertial import MOUNT
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, rotation_z

CIRCLE_SHARE = 0.15  # radius of a circle over the side of their square, at least
REDNESS, TARGET_PX = 60, 12  # of a bright target: red less the other channels, and its least area
TAGS = cv2.aruco.DICT_APRILTAG_36h11


@dataclass(frozen=True)
class Mark:
    """A mark in one picture."""

    pixel: tuple[float, float]  # its middle; (0, 0) is the outer corner of the top-left pixel
    side_px: float  # how long a known length appears: the side of the circles' square, or a target's diameter


Finder = Callable[[Picture], Mark | None]
"""From a picture to the mark in it."""


def circles(picture: Picture) -> Mark | None:
    """Find four dark circles on white: blobs, ellipses through their edges, and the mean of four that form a square."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    scale = 2  # a circle of the smallest plates has few pixels
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByColor, settings.blobColor = True, 0
    settings.filterByArea, settings.minArea, settings.maxArea = True, 40.0 * scale, 4e4
    settings.filterByCircularity, settings.minCircularity = True, 0.75
    settings.filterByConvexity, settings.minConvexity = True, 0.9
    settings.filterByInertia, settings.minInertiaRatio = True, 0.5
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 20.0, 220.0, 10.0
    settings.minDistBetweenBlobs = 4.0
    found = cv2.SimpleBlobDetector.create(settings).detect(large)
    spots = np.array([(*_ellipse(large, spot.pt, spot.size), spot.size) for spot in found]).reshape(-1, 3)
    best: tuple[float, Mark] | None = None
    for spot in spots:
        like = np.abs(np.log(spots[:, 2] / spot[2])) < np.log(1.5)
        near = np.argsort(np.linalg.norm(spots[:, :2] - spot[:2], axis=1) + np.where(like, 0, np.inf))[:4]
        if len(near) < 4 or not like[near].all():
            continue
        four = spots[near, :2]
        middle = four.mean(axis=0)
        arms = np.linalg.norm(four - middle, axis=1)
        angles = np.sort(np.arctan2(*(four - middle).T))
        turns = np.diff(np.append(angles, angles[0] + 2 * np.pi))
        wrong = float(np.ptp(arms) / max(arms.mean(), 1e-9) + np.abs(turns - np.pi / 2).max())
        side = float(arms.mean() * np.sqrt(2))
        if wrong < 0.4 and spot[2] / 2 > CIRCLE_SHARE * side and (best is None or wrong < best[0]):
            # A resized picture keeps the outer corner; OpenCV counts from pixel centres.
            best = wrong, Mark((float(middle[0] + 0.5) / scale, float(middle[1] + 0.5) / scale), side / scale)
    return None if best is None else best[1]


def _ellipse(grey: Picture, point: Sequence[float], size: float) -> tuple[float, float]:
    """Middle of the ellipse through a dark blob's edge; the blob's own where there is none."""
    half = int(size) + 2
    x, y = round(point[0]), round(point[1])
    window = grey[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
    dark = (window < (int(window.min()) + int(window.max())) / 2).astype(np.uint8)
    edges, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    corner = np.array([max(x - half, 0), max(y - half, 0)])
    for edge in edges:
        inside = cv2.pointPolygonTest(edge, (float(point[0] - corner[0]), float(point[1] - corner[1])), False) >= 0
        if len(edge) >= 5 and inside:
            middle = np.array(cv2.fitEllipse(edge)[0]) + corner
            if np.linalg.norm(middle - point) < size / 2:
                return float(middle[0]), float(middle[1])
    return float(point[0]), float(point[1])


def target(picture: Picture) -> Mark | None:
    """Find a bright red target: the middle of the largest red spot."""
    red = picture[..., 0].astype(np.int16) - picture[..., 1:].max(axis=-1)
    mask = (red > REDNESS).astype(np.uint8)
    count, _, stats, middles = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    area = float(stats[largest, cv2.CC_STAT_AREA])
    if area < TARGET_PX:
        return None
    return Mark((float(middles[largest, 0]) + 0.5, float(middles[largest, 1]) + 0.5), 2 * np.sqrt(area / np.pi))


def level_layers(calibration: Calibration, position: Array, side_m: float, ropes: Sequence[float]) -> dict[float, Mark]:
    """Layers as they would be for a level camera: what is assumed where none were measured.

    Parameters
    ----------
    calibration : Calibration
        Whose lens distortion is left out.
    position : ndarray, shape (3,)
        Of the mark from the grab centre A, grab's frame, m.
    side_m : float
        Length of what a `Mark` has as its side.
    ropes : sequence of float
        |OA|, m.
    """
    layers = {}
    for rope in ropes:
        seen = MOUNT.T @ (np.array([0.0, 0.0, -rope]) + position - calibration.offset_m)
        scale = calibration.focal_length_px / seen[2]
        pixel = float(calibration.cx_px + scale * seen[0]), float(calibration.cy_px + scale * seen[1])
        layers[rope] = Mark(pixel, float(scale * side_m))
    return layers


@dataclass(frozen=True, eq=False)
class Layered:
    """A mark's shift from its place at rest as an instrument (`simgrab.instrument.contract.Instrument`).

    Raises
    ------
    CalibrationError
        Without layers, or where their rope lengths do not increase.
    """

    name: str
    find: Finder
    # where the mark is at rest, by |OA|, m, which increases; places between are interpolated, those beyond are the
    # last
    layers: Mapping[float, Mark]
    side_m: float  # length of what a `Mark` has as its side, m
    up_m: float  # of the mark over the grab centre A, m
    rope: Series  # rope lengths, |OA|, m, by the clock of the frames

    def __post_init__(self) -> None:
        ropes = list(self.layers)
        if not ropes or (np.diff(ropes) <= 0).any():
            raise CalibrationError(f"{self.name}: layers with increasing rope lengths are needed, got {ropes}")

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> list[Measurement]:  # noqa: ARG002
        """Measure a record."""
        return [self._one(frame) for frame in frames]

    def _one(self, frame: Frame) -> Measurement:
        if frame.picture is None:
            return Measurement(status="lost", reason=frame.reason or "no picture")
        mark = self.find(frame.picture)
        if mark is None:
            return Measurement(status="missed", reason="no mark was found")
        if frame.time_s is None:
            return Measurement(status="unread", reason="a frame without time has no rope length")
        rope = float(self.rope.at(np.array([frame.time_s]))[0, 0])
        table = np.array([(length, *place.pixel, place.side_px) for length, place in self.layers.items()])
        u, v, side = (np.interp(rope, table[:, 0], column) for column in table[:, 1:].T)
        shift = np.hypot(mark.pixel[0] - u, mark.pixel[1] - v) * self.side_m / side
        return Measurement(
            status="ok",
            alpha=float(np.arctan(shift / max(rope - self.up_m, 0.1))),
            centre=mark.pixel,
            rope_length_m=rope,
        )


FINDERS: Mapping[str, Finder] = MappingProxyType({"wu": circles, "matsuo-target": target})
"""Name → finder of a `Layered` rival.

``wu`` is after Wu et al. (2020). Known: one camera, four marks, ellipses, calibration in layers of height, no tilt of
the camera. Filled in: the finder, and linear interpolation between layers. With layers of `level_layers` it is the
method without its calibration. ``matsuo-target`` is after Matsuo et al. (2004). Known: a commercial video tracker on a
target. Filled in: all else, as for ``wu``.
"""


@dataclass(frozen=True)
class Fiducial:
    """An AprilTag on the grab, and its pose from its corners.

    After Myhre (2016) and Tørdal (2017). Known: ArUco marks on the load and their pose. Filled in: the family 36h11,
    corners refined by OpenCV, the pose of a plane (IPPE), and a level camera at the offset of its calibration. Of the
    pose's rotation only the turn about the vertical is used.
    """

    size_m: float  # edge of the black square
    # of its middle from the middle of the rope ends, grab's frame, m; its first corner is that at (+x, +y)
    position: tuple[float, float, float]
    name: str = "fiducial"

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> list[Measurement]:
        """Measure a record."""
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(TAGS), settings)
        return [self._one(frame, finder, calibration) for frame in frames]

    def _one(self, frame: Frame, finder: cv2.aruco.ArucoDetector, calibration: Calibration) -> Measurement:
        if frame.picture is None:
            return Measurement(status="lost", reason=frame.reason or "no picture")
        corners, _, _ = finder.detectMarkers(cv2.cvtColor(frame.picture, cv2.COLOR_RGB2GRAY))
        if not len(corners):
            return Measurement(status="missed", reason="no tag was found")
        seen = corners[0].reshape(4, 2).astype(float) + 0.5
        c, half = calibration, self.size_m / 2
        points = np.array([[half, half, 0], [half, -half, 0], [-half, -half, 0], [-half, half, 0]])
        matrix = np.array([[c.focal_length_px, 0, c.cx_px], [0, c.focal_length_px, c.cy_px], [0, 0, 1]])
        lens = np.array([c.k1, c.k2, c.p1, c.p2, c.k3])
        ok, turn, way = cv2.solvePnP(points, seen, matrix, lens, flags=cv2.SOLVEPNP_IPPE)
        if not ok:
            return Measurement(status="refused", reason="the tag's corners have no pose")
        outboard = MOUNT @ cv2.Rodrigues(turn)[0][:, 0]
        yaw = np.arctan2(outboard[1], outboard[0])
        end = MOUNT @ way[:, 0] + c.offset_m - rotation_z(yaw) @ self.position
        if end[2] > -1:
            return Measurement(status="refused", reason="the tag's pose is not below the rope's exit")
        middle = seen.mean(axis=0)
        return Measurement(
            status="ok", alpha=float(np.arctan2(np.hypot(end[0], end[1]), -end[2])),
            centre=(float(middle[0]), float(middle[1])),
        )  # fmt: skip

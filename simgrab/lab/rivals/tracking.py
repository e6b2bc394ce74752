"""Where a target is in the pictures of a record, by the classical trackers of the literature."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.contract import Frame, Picture
from simgrab.instrument.detect import Detector, detector
from simgrab.instrument.observation import Observation
from simgrab.model.geometry import Array

PATCH = 0.6  # side of a template, as a share of the detected box's longer side
SEARCH = 0.8  # how far it is sought, as a share of that side
LEAST_SCORE = 0.4  # correlation below which a target counts as not found
LEAST_PX, MOST_PX = 12, 400  # side of a template
FEATURES, LEAST_FEATURES = 120, 12
NOT_YET = "the target was not yet found"
BACK_PX = 0.7  # how far a feature may end from where it began when followed forth and back


Tracker = Callable[[Iterable[Frame]], Iterator[Observation]]
"""From the frames of a record, in order, to the target's centre in each."""


def _first(find: Detector, picture: Picture) -> tuple[Array, Array] | None:
    """Box (4,) and centre (2,) of the target in a picture; the middle of the box where the detector has no centre."""
    found = find(picture)
    if not found.found or found.box is None:
        return None
    return found.box, found.centre if found.centre is not None else (found.box[:2] + found.box[2:]) / 2


Grey = NDArray[np.uint8]
Follow = Callable[[Grey], Array | str]
"""From the next picture to the target's centre, px, or why it was not found."""


def _tracker(begin: Callable[[Grey, Array, Array], Follow]) -> Tracker:
    """Track from the first picture in which the target is detected: its grey, box (4,) and centre (2,)."""

    def track(frames: Iterable[Frame]) -> Iterator[Observation]:
        find = detector()
        follow: Follow | None = None
        for frame in frames:
            if frame.picture is None:
                yield Observation(frame.time_s, lost=frame.reason or "no picture")
                continue
            grey = np.asarray(cv2.cvtColor(frame.picture, cv2.COLOR_RGB2GRAY), np.uint8)
            found: Array | str = NOT_YET
            if follow is not None:
                found = follow(grey)
            elif (begun := _first(find, frame.picture)) is not None:
                follow, found = begin(grey, *begun), begun[1]
            if isinstance(found, str):
                yield Observation(frame.time_s, missed=found)
            else:
                yield Observation(frame.time_s, centre=(float(found[0]), float(found[1])))

    return track


def template(update: float = 0.0) -> Tracker:
    """Track by normalised correlation with a template, refined by a parabola.

    Parameters
    ----------
    update : float
        Share by which the template follows each picture: 0 keeps the first.
    """

    def begin(grey: Grey, box: Array, centre: Array) -> Follow:
        side = float(max(box[2:] - box[:2]))
        half = int(np.clip(PATCH * side / 2, LEAST_PX / 2, MOST_PX / 2))
        reach = max(int(SEARCH * side / 2), 4)
        corner = np.floor(centre - half).astype(int)
        patch, shift = _cut(grey, corner, 2 * half), centre - corner

        def follow(grey: Grey) -> Array | str:
            nonlocal patch, centre
            corner = np.floor(centre - shift + 0.5).astype(int)
            place, score = _match(_cut(grey, corner - reach, 2 * (half + reach)), patch)
            if score < LEAST_SCORE:
                return f"the target correlates by {score:.2f}, at least {LEAST_SCORE:g} is needed"
            centre = corner - reach + place + shift
            if update:
                now = _cut(grey, np.floor(centre - shift + 0.5).astype(int), 2 * half)
                patch = np.asarray((1 - update) * patch + update * now, np.float32)
            return centre

        return follow

    return _tracker(begin)


def _cut(grey: Grey, corner: NDArray[np.int64], side: int) -> NDArray[np.float32]:
    """Cut a square, whose parts beyond the picture repeat its edge."""
    rows = np.clip(np.arange(corner[1], corner[1] + side), 0, grey.shape[0] - 1)
    columns = np.clip(np.arange(corner[0], corner[0] + side), 0, grey.shape[1] - 1)
    return grey[np.ix_(rows, columns)].astype(np.float32)


def _match(window: NDArray[np.float32], patch: NDArray[np.float32]) -> tuple[Array, float]:
    """Where a window has a patch's corner, px, and their correlation there."""
    score = np.nan_to_num(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED))
    y, x = np.unravel_index(int(np.argmax(score)), score.shape)
    place = np.array([x, y], float)
    for axis, (index, line) in enumerate(((int(x), score[y]), (int(y), score[:, x]))):
        if 0 < index < len(line) - 1:
            a, b, c = (float(line[index + k]) for k in (-1, 0, 1))
            place[axis] += (a - c) / (2 * (a - 2 * b + c)) if a - 2 * b + c < 0 else 0.0
    return place, float(score[y, x])


def flow() -> Tracker:
    """Track by the optical flow (Lucas and Kanade, pyramidal) of corners within the first picture's box.

    The target moves, turns and grows as most corners do (a similarity, RANSAC); corners that are lost are replaced by
    new ones within the moved box. Nothing corrects a drift.
    """

    def begin(grey: Grey, box: Array, centre: Array) -> Follow:
        x0, y0, x1, y1 = box
        before, corners = grey, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
        points = _corners(grey, corners, np.zeros((0, 2), np.float32))

        def follow(grey: Grey) -> Array | str:
            nonlocal before, centre, corners, points
            moved = _moved(before, grey, points)
            if moved is None:
                return "too few corners could be followed"
            turn, points = moved
            centre, corners = turn[:, :2] @ centre + turn[:, 2], corners @ turn[:, :2].T + turn[:, 2]
            if len(points) < FEATURES / 2:
                points = _corners(grey, corners, points)
            before = grey
            return centre

        return follow

    return _tracker(begin)


def _corners(grey: Grey, box: Array, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Corners within a box, those that are followed already first; px, shape (n, 2)."""
    mask = np.zeros(grey.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(box).astype(np.int32), 255)
    new = cv2.goodFeaturesToTrack(grey, FEATURES, 0.01, 4, mask=mask)
    if new is None:
        return points
    return np.concatenate([points, new.reshape(-1, 2) + np.float32(0.5)])[:FEATURES]


def _moved(before: Grey, after: Grey, points: NDArray[np.float32]) -> tuple[Array, NDArray[np.float32]] | None:
    """Similarity (2, 3) from one picture to the next, and where the corners went that follow it."""
    if len(points) < LEAST_FEATURES:
        return None
    old = points - np.float32(0.5)
    new, ok, _ = cv2.calcOpticalFlowPyrLK(before, after, old, None, winSize=(15, 15), maxLevel=3)
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(after, before, new, None, winSize=(15, 15), maxLevel=3)
    good = (ok[:, 0] == 1) & (ok_back[:, 0] == 1) & (np.linalg.norm(back - old, axis=1) < BACK_PX)
    if good.sum() < LEAST_FEATURES:
        return None
    old, new = old[good] + np.float32(0.5), new[good] + np.float32(0.5)
    cv2.setRNGSeed(0)  # RANSAC draws
    turn, inside = cv2.estimateAffinePartial2D(old, new, method=cv2.RANSAC, ransacReprojThreshold=1.5)
    if turn is None or inside.sum() < LEAST_FEATURES:
        return None
    return np.asarray(turn), new[inside[:, 0] == 1]

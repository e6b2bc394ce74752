import cv2
import numpy as np
import pytest

from simgrab.instrument.detect.bundled import WEIGHTS, GrabDetector, Settings
from simgrab.instrument.detect.flips import averaged

WIDTH, HEIGHT = 640, 400
BOX = np.array([200.0, 120.0, 310.0, 240.0])


def cloudy(seed):
    coarse = np.random.default_rng(seed).integers(0, 256, (40, 64, 3), np.uint8)
    return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def mirrored(box):
    return np.array([WIDTH - box[2], box[1], WIDTH - box[0], box[3]])


def both(looks, picture):
    """Run refine and settle on a picture, and its mirror image, laid back."""
    for shown, box, laid in ((picture, BOX, False), (picture[:, ::-1], mirrored(BOX), True)):
        refined = looks.refine(shown, [box], last=True)
        posed = looks.predict_pose(shown, refined.one(0))
        for found in (refined, posed):
            centre, yaw, sd = found.centres[0], found.yaw[0], found.box_sd[0]
            if laid:
                yield (
                    mirrored(found.boxes[0]), sd[[2, 1, 0, 3]], [WIDTH - centre[0], centre[1]], found.centre_sd[0],
                    2 * (np.pi - yaw), refined.presence[0],
                )  # fmt: skip
            else:
                yield found.boxes[0], sd, centre, found.centre_sd[0], 2 * yaw, refined.presence[0]


def apart(looks, picture):
    """By how much the two differ, px, and how far apart directions and presences are."""
    *first, second, third = both(looks, picture)
    differences = []
    for one, other in zip(first, (second, third), strict=True):
        places = max(float(np.abs(np.subtract(a, b)).max()) for a, b in zip(one[:4], other[:4], strict=True))
        turned = float(np.hypot(np.cos(one[4]) - np.cos(other[4]), np.sin(one[4]) - np.sin(other[4])))
        differences.append((places, turned, abs(one[5] - other[5])))
    return np.max(differences, axis=0)


@pytest.mark.parametrize("seed", range(4))
def test_a_mirrored_picture_gives_the_mirrored_answer(seed):
    looks = GrabDetector(WEIGHTS / "any-grab", Settings(flips=4))
    np.testing.assert_array_less(apart(looks, cloudy(seed)), (0.1, 0.01, 0.001))
    assert apart(GrabDetector(WEIGHTS / "any-grab", Settings(flips=1)), cloudy(seed))[0] > 1


def test_a_yaw_is_averaged_as_a_direction():
    rows = np.zeros((2, 16))
    rows[0, 12:14], rows[1, 12:14] = (1, 0), (0, -5)  # the latter of the mirror image
    found = averaged(rows, 2)[0, 12:14]
    assert np.arctan2(found[1], found[0]) == pytest.approx(np.pi / 4)

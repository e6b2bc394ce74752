import cv2
import numpy as np
import pytest

from simgrab.instrument.detect.bundled import WEIGHTS, Bundled, Settings
from simgrab.instrument.detect.flips import FLIPS, averaged, flipped

WIDTH, HEIGHT = 640, 400
BOX = np.array([200.0, 120.0, 310.0, 240.0])


def cloudy(seed):
    coarse = np.random.default_rng(seed).integers(0, 256, (40, 64, 3), np.uint8)
    return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def mirrored(box):
    return np.array([WIDTH - box[2], box[1], WIDTH - box[0], box[3]])


def both(looks, picture):
    """Refine and settle a picture, and its mirror image, laid back."""
    for shown, box, laid in ((picture, BOX, False), (picture[:, ::-1], mirrored(BOX), True)):
        refined = looks.refine(shown, [box], last=True)
        settled = looks.settle(shown, refined.one(0))
        for found in (refined, settled):
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
    looks = Bundled(WEIGHTS / "any-grab", Settings(flips=4))
    np.testing.assert_array_less(apart(looks, cloudy(seed)), (0.1, 0.01, 0.001))
    assert apart(Bundled(WEIGHTS / "any-grab", Settings(flips=1)), cloudy(seed))[0] > 1


def test_rows_of_mirrored_crops_are_laid_back():
    row = np.arange(16) / 10
    row[12:14] = 0.6, -0.8
    across, down = row.copy(), row.copy()
    across[[0, 2, 4, 6, 8, 13]] = 1 - row[2], 1 - row[0], 1 - row[4], row[8], row[6], -row[13]
    down[[1, 3, 5, 7, 9, 13]] = 1 - row[3], 1 - row[1], 1 - row[5], row[9], row[7], -row[13]
    rows = np.stack([row, across, down, across])
    rows[3, 1::2], rows[3, 13] = down[1::2], row[13]  # both
    np.testing.assert_allclose(averaged(rows[:2], 2), [row])
    np.testing.assert_allclose(averaged(rows, 4), [row])
    np.testing.assert_allclose(averaged(rows[[1, 0]], 2), [across])


def test_a_yaw_is_averaged_as_a_direction():
    rows = np.zeros((2, 16))
    rows[0, 12:14], rows[1, 12:14] = (1, 0), (0, -5)  # the latter of the mirror image
    found = averaged(rows, 2)[0, 12:14]
    assert np.arctan2(found[1], found[0]) == pytest.approx(np.pi / 4)


def test_crops_are_mirrored_in_the_order_that_is_stated():
    crops = np.arange(2 * 3 * 3 * 4, dtype=np.uint8).reshape(2, 3, 3, 4)
    found = flipped(crops, 4)
    assert found.shape == (8, 3, 3, 4)
    np.testing.assert_array_equal(found[:2], crops)
    for way, (across, down) in enumerate(FLIPS):
        expected = crops[:, ::-1] if down else crops
        np.testing.assert_array_equal(found[2 * way + 1], (expected[:, :, ::-1] if across else expected)[1])

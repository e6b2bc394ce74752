import cv2
import numpy as np
import pytest

from simgrab.world.camera.row_blocks import ROWS, each_block, enlarged, threaded_map


def by_threads(make):
    """What a function gives with 1, 2 and 5 threads of OpenCV."""
    before = cv2.getNumThreads()
    try:
        for threads in (1, 2, 5):
            cv2.setNumThreads(threads)
            yield make()
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize("height", [1, ROWS, ROWS + 1, 1080])
def test_every_row_is_worked_on_once(height):
    times = np.zeros(height, int)

    def work(rows):
        times[rows] += 1

    for count, _ in enumerate(by_threads(lambda: each_block(height, work)), 1):
        assert (times == count).all()


def test_results_come_in_order_and_errors_come_through():
    for found in by_threads(lambda: threaded_map(np.square, range(100))):
        assert found == [x * x for x in range(100)]
        with pytest.raises(ZeroDivisionError):
            each_block(300, lambda rows: 1 // (rows.start - 96))


@pytest.mark.parametrize("times", [1, 2, 8])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_blocks_are_those_of_the_whole_enlarged_picture(times, channels):
    coarse = np.random.default_rng(0).random((30, 40, *channels), np.float32)
    whole = cv2.resize(coarse, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
    height, width = 30 * times - 1, 40 * times - 1
    for top in range(0, height, 7):
        rows = slice(top, min(top + 7, height))
        np.testing.assert_allclose(enlarged(coarse, times, rows, width), whole[rows, :width], atol=1e-6)

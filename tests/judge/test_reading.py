import numpy as np
import pytest

from simgrab.judge.evaluate import reading
from simgrab.judge.evaluate.reading import Read, share
from simgrab.judge.evaluate.values import Lengths, Wrong

NO_LENGTHS = np.empty(0)


def test_every_kind_of_frame_is_counted_once():
    right, wrong, refused = (
        Read("f", "2015 2137", "2015 2137", found) for found in ("2015 2137", "2013 2737", "20?5 2138")
    )
    score = reading.score([right, wrong, refused], 2, np.array([0.1, 0.3]))
    assert score.digits_right == share(20, 23)  # the refused one's other digits were read, one of them wrong
    assert score.digits_refused == share(1, 24)
    assert score.frames_right == share(1, 2)
    assert score.frames_refused == share(1, 3)
    assert score.torn_right == score.torn_refused == share(0, 0)
    assert (score.jumps, score.length) == (2, Lengths(2, 0.2, pytest.approx(0.29), 0.3))
    assert score.wrong == [Wrong("f", "2015 2137", "2013 2737")]


def test_torn_displays_are_scored_apart():
    """Each number may be as above or as below; digits of both in one number are a mixture."""
    cases = ("2015 2137", "1899 0266", "2015 0266", "1815 2137", "20?? 2137")  # the last but one is a mixture
    reads = [Read("f", "2015 2137", "1899 0266", found) for found in cases]
    score = reading.score(reads, 0, NO_LENGTHS)
    assert score.torn_right == share(3, 5)
    assert score.torn_refused == share(1, 5)
    assert score.wrong == [Wrong("f", "2015 2137 over 1899 0266", "1815 2137")]
    assert score.digits_right == score.frames_right == share(0, 0)

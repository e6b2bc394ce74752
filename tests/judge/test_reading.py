import numpy as np

from simgrab.judge.evaluate import reading
from simgrab.judge.evaluate.reading import Read, share
from simgrab.judge.evaluate.values import Wrong
from simgrab.model.records.observations import Reading


def read(text, found, *, below=None, status=None, frame="f", group="rain"):
    hoist, closing = found.split()
    status = status or ("refused" if "?" in found else "read")
    made = Reading(status, "", hoist, closing, np.ones(8), None, None, None)
    return Read(frame, group, text, below or text, made)


def test_every_kind_of_frame_is_counted_once():
    right, wrong, refused = (
        read("2015 2137", "2015 2137"),
        read("2015 2137", "2013 2737"),
        read("2015 2137", "20?5 2138"),
    )
    score = reading.score([right, wrong, refused])
    assert score.digits_right == share(20, 23)  # the refused one's other digits were read, one of them wrong
    assert score.digits_refused == share(1, 24)
    assert score.frames_right == share(1, 2)
    assert score.frames_refused == share(1, 3)
    assert score.torn_right == score.torn_refused == share(0, 0)
    assert score.wrong == [Wrong("f", "rain", "2015 2137", "2013 2737")]


def test_torn_displays_are_scored_apart():
    """Each number may be as above or as below; digits of both in one number are a mixture."""
    cases = ("2015 2137", "1899 0266", "2015 0266", "1815 2137", "20?? 2137")  # the last but one is a mixture
    reads = [read("2015 2137", found, below="1899 0266") for found in cases]
    score = reading.score(reads)
    assert score.torn_right == share(3, 5)
    assert score.torn_refused == share(1, 5)
    assert score.wrong == [Wrong("f", "rain", "2015 2137 over 1899 0266", "1815 2137")]
    assert score.digits_right == score.frames_right == share(0, 0)

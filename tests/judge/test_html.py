"""Pages of the same figures are the same."""

from matplotlib.figure import Figure

from simgrab.pages.html import svg


def figure():
    made = Figure()
    made.subplots().plot([1, 2], [3, 4], marker="o")
    return made


def test_a_figure_is_written_as_the_same_bytes_each_time():
    assert svg(figure(), "a") == svg(figure(), "a")
    assert svg(figure(), "a") != svg(figure(), "b")

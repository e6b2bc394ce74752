"""Pages of the same figures are the same, and figures have labels."""

from matplotlib.figure import Figure

from simgrab.reports.html import svg


def figure():
    made = Figure()
    made.subplots().plot([1, 2], [3, 4], marker="o")
    return made


def test_a_figure_is_written_as_the_same_bytes_each_time():
    assert svg(figure(), "a", "Swing") == svg(figure(), "a", "Swing")
    assert svg(figure(), "a", "Swing") != svg(figure(), "b", "Swing")


def test_a_label_of_a_figure_is_escaped():
    assert '<svg role="img" aria-label="&#34;&gt;&lt;script&gt;"' in svg(figure(), "a", '"><script>')

"""Any path can be printed, and every message is one line."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgrab import errors
from simgrab.errors import MOST_CHARACTERS, PictureError, RunError, ScenarioError, SimgrabError
from simgrab.text import printable

ANY = st.text(st.characters(), max_size=40)  # surrogates included, which names that are no UTF-8 are decoded to


@given(ANY, ANY, st.sampled_from([1, 60]))
def test_every_message_is_one_printable_line(key, problem, times):
    for error in (
        SimgrabError(problem * times),
        ScenarioError(key * times, problem),
        RunError(ScenarioError(key, problem)),
        PictureError(key * times, problem),
    ):
        assert str(error).isprintable()
        assert len(str(error)) <= MOST_CHARACTERS


@given(ANY)
def test_nothing_cannot_be_shown(text):
    shown = printable(text)
    assert shown.encode("utf-8").decode() == shown
    assert len(shown.splitlines()) <= 1
    assert printable(shown) == shown


def test_paths_are_shown_as_utf_8_and_what_is_none_by_escapes():
    assert printable("plain/ü雪 a.jpg") == "plain/ü雪 a.jpg"
    assert printable(os.fsdecode(b"a\xff.jpg")) == r"a\xff.jpg"
    assert printable("a\nb\x1b[31m") == r"a\nb\x1b[31m"
    ascii_locale = "ü雪".encode().decode("ascii", "surrogateescape")  # what LC_ALL=C makes of the name
    assert printable(ascii_locale) == "ü雪"
    assert str(ScenarioError("a\nb", "α must be ≤ 10°, got '年月日'")) == r"a\nb: α must be ≤ 10°, got '年月日'"


def test_a_long_message_keeps_both_ends():
    text = str(RunError("run.json: " + "x" * 5000 + " is no number"))
    assert text.startswith("run.json: x")
    assert text.endswith("x is no number")
    assert " … " in text


@pytest.mark.parametrize(
    "kind", [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, SimgrabError)]
)
def test_no_error_prints_itself_otherwise(kind):
    assert kind.__str__ is SimgrabError.__str__

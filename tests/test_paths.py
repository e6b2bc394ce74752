"""Any path can be printed."""

import os

from hypothesis import given
from hypothesis import strategies as st

from simgrab.errors import DatasetError, PictureError, ScenarioError
from simgrab.text import printable


def test_paths_are_shown_as_utf_8_and_what_is_none_by_escapes():
    assert printable("plain/ü雪 a.jpg") == "plain/ü雪 a.jpg"
    assert printable(os.fsdecode(b"a\xff.jpg")) == r"a\xff.jpg"
    assert printable("a\nb\x1b[31m") == r"a\nb\x1b[31m"
    ascii_locale = "ü雪".encode().decode("ascii", "surrogateescape")  # what LC_ALL=C makes of the name
    assert printable(ascii_locale) == "ü雪"


@given(st.text(st.characters(codec=None)))
def test_nothing_cannot_be_shown(text):
    shown = printable(text)
    assert shown.encode("utf-8").decode() == shown
    assert len(shown.splitlines()) <= 1
    assert printable(shown) == shown


def test_errors_can_be_printed(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff.jpg")
    for error in (DatasetError(f"{path}: no"), ScenarioError(str(path), "no"), PictureError(path, "no")):
        assert r"\xff.jpg" in str(error)
        str(error).encode("utf-8")

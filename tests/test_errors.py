import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgrab import errors
from simgrab.errors import MOST_CHARACTERS, RunError, ScenarioError, SimgrabError

ANY = st.text(st.characters(), max_size=40)  # surrogates included, which names that are no UTF-8 are decoded to


@given(ANY, ANY, st.sampled_from([1, 60]))
def test_every_message_is_one_printable_line(key, problem, times):
    for error in (
        SimgrabError(problem * times),
        ScenarioError(key * times, problem),
        RunError(ScenarioError(key, problem)),
    ):
        assert str(error).isprintable()
        assert len(str(error)) <= MOST_CHARACTERS


def test_what_can_be_printed_stays_as_it_is():
    assert str(RunError("é.toml: α must be ≤ 10°, got '年月日'")) == "é.toml: α must be ≤ 10°, got '年月日'"
    assert str(ScenarioError("a\nb", "unknown key")) == r"a\nb: unknown key"
    assert str(RunError("\udcff.toml")) == r"\xff.toml"


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

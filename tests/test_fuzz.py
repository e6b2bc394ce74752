import pytest
from conftest import slow_but

from scripts.without_room import ROOMS

for needed in ("onnx", *(f"simgrab.{room}" for room in ROOMS)):
    pytest.importorskip(needed)

from scripts import fuzz  # noqa: E402
from scripts.fuzzing import corpus, documents, generators  # noqa: E402
from scripts.fuzzing.watch import (  # noqa: E402
    ACCEPTED,
    LIMIT,
    MESSAGE,
    REFUSED,
    SIGNAL,
    TRACEBACK,
    Limits,
    Watched,
)  # fmt: skip

EXPECTED = {
    "accepted": (ACCEPTED, ""),
    "refused": (REFUSED, "width_px: must be 1"),
    "raises": (TRACEBACK, "KeyError: 'key'"),
    "escape": (MESSAGE, "not printable"),
    "long": (MESSAGE, "1001 characters"),
    "empty": (MESSAGE, "without a text"),
    "aborts": (SIGNAL, "SIGABRT"),
    "dies": (SIGNAL, "exit with 7"),
    "computes": (LIMIT, "longer than 1 s"),
    "sleeps": (LIMIT, "not done after 1 s"),
    "memory": (LIMIT, "more than 300 MiB"),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return corpus.make(tmp_path_factory.mktemp("made") / "corpus")


def test_each_fault_is_seen_and_attributed_to_its_input(tmp_path):
    limits = dict.fromkeys(EXPECTED, Limits(memory_mib=300)) | {
        "computes": Limits(seconds=1), "sleeps": Limits(waiting=1),
    }  # fmt: skip
    with Watched("hostile", tmp_path, tmp_path / "printed", Limits()) as watched:
        outcomes = {}
        for name in EXPECTED:
            watched.limits = limits[name]
            outcomes[name] = watched.open(name, tmp_path / "input")
        assert watched.open("accepted", tmp_path / "input").status == ACCEPTED
    for name, (status, text) in EXPECTED.items():
        assert outcomes[name].status == status, (name, outcomes[name])
        assert text in outcomes[name].text, (name, outcomes[name])


@pytest.mark.parametrize("kind", ["scenario", "camera", "run", "table", "picture", "video", "detector"])
def test_the_same_seed_makes_the_same_inputs(made, kind):
    first, again, other = (list(generators.cases(kind, 6, seed, made)) for seed in (5, 5, 6))
    assert first == again
    assert first != other
    structured = generators.KINDS[kind](made).structured is not None
    assert {case.generator for case in first} == ({"structure", "bytes"} if structured else {"bytes"})


def test_documents_are_written_as_they_are_read():
    import json
    import tomllib

    document = {"a": [1, 2.5, {"b.c": "d\n\x7f\u2028"}], "e": {"": True}}
    assert json.loads(documents.as_json(document)) == document
    assert tomllib.loads(documents.as_toml(document)) == document


CHEAP = ["scenario", "camera", "table"]


@pytest.mark.parametrize(("kinds", "count"), [(CHEAP, 60), *slow_but([(list(generators.KINDS), 320)])])
def test_hostile_files_are_accepted_or_refused_in_one_line(made, tmp_path, kinds, count):
    tallies = fuzz.fuzz(kinds, count, 0, tmp_path, made=made)
    failed = [(str(path), outcome.text) for tally in tallies for path, outcome in tally.failures]
    assert not failed
    for tally in tallies:
        assert tally.counts[ACCEPTED], f"no {tally.kind} is accepted: its inputs reach nothing behind the reader"
        assert tally.counts[REFUSED], tally.kind

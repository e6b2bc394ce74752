"""A killed command, run again, gives what it gives undisturbed."""

import pytest

from scripts.kill_runs import WORKER, Killer


@pytest.fixture(scope="module")
def killer(tmp_path_factory):
    killer = Killer(tmp_path_factory.mktemp("kills"), ["render", "video"])
    killer.prepare()
    return killer


@pytest.mark.slow
@pytest.mark.parametrize(("command", "kind"), [("render", WORKER), ("video", "SIGKILL")])
def test_killed_and_run_again_it_gives_the_same_bytes(killer, command, kind):
    killer.kill(command, kind, 0.6)
    assert killer.notes == []


@pytest.mark.slow
def test_what_differs_is_found(killer):
    labels, extra = "labels.parquet", "images/train/999999.jpg"
    expected = killer.expected["render"]
    try:
        killer.expected["render"] = expected | {labels: "other", extra: "there is none"}
        killer.kill("render", "SIGINT", 1.0)
        notes = " ".join(killer.notes)
        assert f"differs: {labels}" in notes
        assert f"lost: {extra}" in notes
    finally:
        killer.expected["render"] = expected
        killer.notes.clear()

"""A killed command, run again, gives what it gives undisturbed."""

import pytest

from scripts.kill_runs import WORKER, Killer


@pytest.fixture(scope="module")
def killer(tmp_path_factory):
    killer = Killer(tmp_path_factory.mktemp("kills"), ["render", "video"])
    killer.prepare()
    return killer


@pytest.mark.slow
def test_killed_and_run_again_it_gives_the_same_bytes(killer):
    killer.kill("video", "SIGKILL", 0.6)
    assert killer.notes == []


@pytest.mark.slow
def test_what_differs_is_found_and_nothing_else_after_a_workers_death(killer):
    labels, extra = "labels.parquet", "images/train/999999.jpg"
    killer.expected["render"] |= {labels: "other", extra: "there is none"}
    killer.kill("render", WORKER, 0.6)
    found = [note.split(": ", 1)[1] for note in killer.notes]
    assert found == [f"half: {labels}", f"lost: {extra}", f"differs: {labels}"]

"""A place where no result could be written is refused before anything is computed, and nothing is left there."""

import importlib.util
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from simgrab.cli import cli
from simgrab.errors import RunError, SimgrabError
from simgrab.instrument.run import runs
from simgrab.io.destination import check_file, check_folder, check_new_folder

AFILE, DANGLING, LONG = "afile", "dangling", "n" * 250
# By place: what its refusal says. Each is refused as a folder and as a file.
BAD = {
    f"{AFILE}/below/out": "afile is a file, not a folder",
    f"{DANGLING}/out": "dangling is a link to gone, which does not exist",
    DANGLING: "dangling is a link to gone, which does not exist",
    LONG: "a name must have at most",
    f"new/{LONG}/out": "a name must have at most",
    "n" * 300: "File name too long",
    "d/" * 2020 + "out": "File name too long",
    "pipe": "pipe",
    "a\0b": "null",
    "/proc/simgrab": "/proc/simgrab",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(AFILE).write_text("mine")
    Path(DANGLING).symlink_to("gone")
    Path("folder").mkdir()
    os.mkfifo("pipe")
    return tmp_path


def everything(folder):
    return sorted((str(path), path.lstat().st_mtime_ns) for path in folder.rglob("*"))


@pytest.mark.parametrize("check", [check_folder, check_new_folder, check_file])
@pytest.mark.parametrize("place", BAD)
def test_bad_places_are_refused_in_one_line(check, place, here):
    before = everything(here)
    with pytest.raises(RunError) as problem:
        check(Path(place), RunError)
    message = BAD[place]
    assert message in str(problem.value) or (place == "pipe" and "exists" in str(problem.value))
    assert "\n" not in str(problem.value)
    assert everything(here) == before


def test_what_lies_at_the_place_itself_counts(here):
    with pytest.raises(RunError, match="afile is a file, not a folder; choose another --out"):
        check_folder(Path(AFILE), RunError)
    with pytest.raises(RunError, match="folder exists; choose another --out, or remove it"):
        check_new_folder(Path("folder"), RunError)
    with pytest.raises(RunError, match="it is a folder, not a file; choose another --page"):
        check_file(Path("folder"), RunError, "--page")
    for place in ("folder", "new/within/out", ".", str(here)):
        check_folder(Path(place), RunError)
    check_new_folder(Path("new/within/out"), RunError)
    check_file(Path(AFILE), RunError)
    check_file(Path("new/within/page.html"), RunError)
    assert not Path("new").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_refused(here):
    (here / "folder").chmod(0o500)
    for check, place in ((check_folder, "folder"), (check_folder, "folder/out"), (check_file, "folder/page.html")):
        with pytest.raises(RunError, match="folder: Permission denied"):
            check(here / place, RunError)


# By verb: arguments with the place to come, and what must not have been called by then.
VERBS = {
    "render": (["render", "--out"], "simgrab.dataset.pool.vetted"),
    "render a video": (["render", "--out", "data", "--video"], "simgrab.dataset.pool.vetted"),
    "render a video alone": (["render", "--video"], "simgrab.dataset.pool.vetted"),
    "run": (["run", "none.mp4", "--out"], "simgrab.instrument.pipeline.assemble"),
    "check": (["check", "smoke", "--out"], "simgrab.judge.check.gate.check"),
    "check's cache": (["check", "smoke", "--cache"], "simgrab.judge.check.gate._instrument"),
    "check's baseline": (["check", "smoke", "--update-baseline", "--baseline"], "simgrab.judge.check.gate._instrument"),
    "stress": (["stress", "sigma", "--out"], "simgrab.lab.stress.catalogue.load"),
    "stress --replay": (["stress", "--replay", "sigma", "1", "--out"], "simgrab.lab.stress.catalogue.load"),
    "paper": (["paper", "--out"], "simgrab.lab.paper.run.study"),
    "evaluate": (["evaluate", "none", "none", "--page"], "simgrab.instrument.run.runs.load"),
    "detect": (["detect", "none", "--out"], "simgrab.instrument.detect.pictures.detect"),
    "train detector": (["train", "detector", "none", "--out"], "simgrab.training.need_torch"),
    "train reader": (["train", "reader", "none", "--out"], "simgrab.training.need_torch"),
}
VERBS = {verb: case for verb, case in VERBS.items() if importlib.util.find_spec(".".join(case[1].split(".")[:2]))}
ENDINGS = {"render a video": ".mp4", "render a video alone": ".mp4", "detect": ".csv"}


@pytest.mark.parametrize("place", [AFILE, f"{AFILE}/out", DANGLING, "/proc/simgrab", ""])
@pytest.mark.parametrize("verb", VERBS)
def test_verbs_refuse_a_place_before_they_compute(verb, place, here, monkeypatch):
    arguments, first = VERBS[verb]
    if verb in ENDINGS and place:
        ending = ENDINGS[verb]
        Path(f"{AFILE}{ending}").mkdir()
        Path(f"{DANGLING}{ending}").symlink_to("gone")
        place += ending
    elif verb == "evaluate" and place == AFILE:
        place = "folder"
    module, name = first.rsplit(".", 1)
    monkeypatch.setattr(importlib.import_module(module), name, lambda *_, **__: pytest.fail(f"{name} was called"))
    before = everything(here)
    result = CliRunner().invoke(cli, [*arguments, place])
    if not place:
        assert result.exit_code == 2
        assert "must not be empty" in result.output
        return
    assert isinstance(result.exception, SimgrabError), result.exception
    assert place in str(result.exception)
    assert "choose another" in str(result.exception)
    assert everything(here) == before


def test_the_second_of_two_runs_is_refused(tmp_path):
    def second():
        with runs.making(tmp_path / "out") as folder:
            (folder / "mine").touch()
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "theirs").touch()

    with pytest.raises(RunError, match="out was written by another run in the meantime; choose another --out"):
        second()
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "theirs"]

"""Files appear whole or not at all."""

import os
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from simgrab.io.files import discard, drafted, drafted_folder, locked, remove_left

CUT_OFF = """
import os, pathlib, sys
from simgrab.io.files import {kind}
with {kind}(pathlib.Path(sys.argv[1])) as draft:
    {write}
    os._exit(9)
"""
WRITE = {"drafted": "draft.write_text('half')", "drafted_folder": "(draft / 'half').write_text('half')"}


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_takes_its_place_at_the_end(tmp_path):
    path = tmp_path / "new" / "a.txt"
    with drafted(path) as draft:
        draft.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert names(path.parent) == ["a.txt"]


def test_what_was_there_outlives_an_error(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with suppress(KeyboardInterrupt), drafted(path) as draft:
        draft.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "before"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("kind", WRITE)
def test_what_a_killed_process_left_goes_when_the_next_one_writes(tmp_path, kind):
    path = tmp_path / "[a].x"
    code = CUT_OFF.format(kind=kind, write=WRITE[kind])
    assert subprocess.run([sys.executable, "-c", code, str(path)], check=False).returncode == 9
    assert not path.exists()
    assert len(names(tmp_path)) == 1
    reused = tmp_path / f".[a].x.{os.getppid()}-0.draft"  # its number is another process's now
    reused.mkdir()
    (reused / "half").touch()
    foreign = tmp_path / ".[a].x.notes.draft"
    foreign.touch()
    with {"drafted": drafted, "drafted_folder": drafted_folder}[kind](path) as draft:
        draft.touch() if kind == "drafted" else (draft / "whole").touch()
    assert names(tmp_path) == sorted([foreign.name, path.name])


@pytest.mark.parametrize("kind", WRITE)
def test_a_draft_that_a_process_works_on_is_left_alone(tmp_path, kind):
    path = tmp_path / "a.x"
    code = CUT_OFF.format(kind=kind, write=WRITE[kind]).replace("os._exit(9)", "print(flush=True); input()")
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        process.stdout.readline()
        remove_left(path)
        with drafted(path) as ours, drafted(path) as another:  # nor do two of one process meet
            assert len(names(tmp_path)) == 3
            ours.touch()
            another.touch()
        path.unlink()
        process.communicate("\n")
    assert process.returncode == 0
    assert names(tmp_path) == ["a.x"]


def test_a_folder_is_gone_at_once(tmp_path):
    path = tmp_path / "a"
    (path / "b").mkdir(parents=True)
    discard(path)
    assert names(tmp_path) == []
    code = "import os, pathlib, shutil, sys\nfrom simgrab.io import files\n"
    code += "shutil.rmtree = lambda *_, **__: os._exit(9)\n"
    (path / "b").mkdir(parents=True)
    subprocess.run([sys.executable, "-c", f"{code}files.discard(pathlib.Path(sys.argv[1]))", str(path)], check=False)
    assert not path.exists()
    assert len(names(tmp_path)) == 1
    remove_left(path)
    assert names(tmp_path) == []


def test_a_full_folder_is_in_the_way(tmp_path):
    path = tmp_path / "run"
    path.mkdir()
    (path / "theirs").touch()
    with pytest.raises(OSError, match="not empty"), drafted_folder(path) as draft:
        (draft / "mine").touch()
    assert names(path) == ["theirs"]
    assert names(tmp_path) == ["run"]


def test_a_locked_file_is_locked_until_it_is_left(tmp_path):
    lock = tmp_path / "lock"
    lock.write_text("theirs")
    waiting = threading.Thread(target=lambda: locked(lock, wait=True).__enter__())
    with locked(lock):
        with pytest.raises(BlockingIOError), locked(lock):
            pass
        waiting.start()
        waiting.join(0.2)
        assert waiting.is_alive()
    waiting.join()
    with locked(lock):
        assert lock.read_text() == "theirs"


def test_a_lock_is_a_file_of_its_own(tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    (tmp_path / "link").symlink_to(mine)
    (tmp_path / "loose").symlink_to(tmp_path / "new")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, why in (("link", "is a link"), ("loose", "is a link"), ("pipe", "not a file"), ("folder", "directory")):
        with pytest.raises(OSError, match=why), locked(tmp_path / name):
            pass
    assert mine.read_text() == "mine"
    assert not (tmp_path / "new").exists()


def test_what_has_a_drafts_name_is_neither_followed_nor_waited_for(tmp_path):
    path = tmp_path / "a.x"
    mine = tmp_path / "mine.txt"
    mine.touch()
    (tmp_path / ".a.x.1-1.draft").symlink_to(mine)
    os.mkfifo(tmp_path / ".a.x.1-2.draft")  # which would be waited for
    for name in (".a.x.b.1-1.draft", ".a.x.1-1-1.draft", ".a.x..1-1.draft"):  # of other files
        (tmp_path / name).touch()
    remove_left(path)
    assert names(tmp_path) == [".a.x..1-1.draft", ".a.x.1-1-1.draft", ".a.x.1-1.draft", ".a.x.b.1-1.draft", "mine.txt"]
    dots = tmp_path / "..."
    (tmp_path / ".....1-1.draft").touch()
    remove_left(dots)
    assert ".....1-1.draft" not in names(tmp_path)

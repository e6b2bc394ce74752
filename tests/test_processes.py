"""A pool gives what its work gives, whatever becomes of its processes."""

import itertools
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import pytest

from simgrab.errors import DatasetError, WorkerError
from simgrab.runtime.processes import ATTEMPTS, PLACE, Pool, tick

ready = None


def square(x):
    return x * x


def get_ready(value):
    global ready
    ready = value


def number(_item: int) -> str:
    time.sleep(0.2)
    return os.environ[PLACE]


def what_is_ready(_):
    return ready, os.environ.get("SIMGRAB_TEST")


def refuse():
    raise DatasetError("no renderer")


class Dying:
    """Ticks at each of three steps; at the second one of ``fatal`` its worker kills itself, ``times`` times in all."""

    def __init__(self, folder, fatal, times=1, number=signal.SIGKILL):
        self.folder, self.fatal, self.times, self.number = Path(folder), fatal, times, number

    def __call__(self, item):
        for step in range(3):
            tick()
            if step == 1 and item == self.fatal and len(list(self.folder.glob("death-*"))) < self.times:
                (self.folder / f"death-{os.getpid()}").touch()
                os.kill(os.getpid(), self.number)
        (self.folder / f"done-{item}").touch()
        return item * item


def dies_while_it_ticks(marker):
    """Killed in the middle of a tick, as like as not."""
    if not marker.exists():
        marker.touch()
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGKILL)).start()
        while True:
            tick()
    tick()


def cleans_up(folder):
    if (folder / "begun").exists():
        return
    (folder / "begun").touch()
    try:
        time.sleep(600)
    finally:
        (folder / "clean").touch()


def raises(item):
    raise DatasetError(f"item {item} is bad")


def gives_a_lock(_):
    return threading.Lock()


def pid(_):
    return os.getpid()


def holds_the_interpreter(marker):
    """Never returns from C code that never releases the GIL."""
    marker.write_text(str(os.getpid()))
    deque(itertools.repeat(None), maxlen=0)


def naps(item):
    time.sleep(600 if item else 0)


def name(item):
    return f"frame {item}"


@pytest.mark.parametrize("workers", [1, 2])
def test_everything_is_done_once(workers):
    with Pool(workers) as pool:
        assert sorted(pool.map(square, range(20))) == [x * x for x in range(20)]
        assert sorted(pool.map(str, range(3))) == ["0", "1", "2"]


def test_items_are_taken_as_workers_are_free():
    taken = []
    with Pool(1) as pool, closing(pool.map(square, (taken.append(x) or x for x in range(9)))) as done:
        assert next(done) == 0
        assert taken == [0, 1]


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSEGV, marks=pytest.mark.slow)])
def test_a_worker_that_dies_once_costs_nothing_but_time(tmp_path, caplog, number):
    ticks = []
    with caplog.at_level(logging.WARNING), Pool(2) as pool:
        done = pool.map(Dying(tmp_path, 3, number=number), range(6), name=name, ticked=ticks.append)
        assert sorted(done) == [x * x for x in range(6)]
    assert len(list(tmp_path.glob("death-*"))) == 1
    (message,) = caplog.messages
    assert message.startswith("frame 3: its worker process ")
    assert ticks[-1] == 18
    assert ticks == sorted(ticks)


def test_an_item_that_kills_every_worker_is_named_and_the_others_kept(tmp_path):
    with Pool(1) as pool, pytest.raises(WorkerError, match=r"^frame 3: 3 worker processes .*SIGKILL"):
        list(pool.map(Dying(tmp_path, 3, times=99), range(6), name=name))
    assert len(list(tmp_path.glob("death-*"))) == ATTEMPTS
    assert sorted(path.name for path in tmp_path.glob("done-*")) == ["done-0", "done-1", "done-2"]
    with Pool(1) as pool:  # what killed it is gone
        assert sorted(pool.map(Dying(tmp_path, 3, times=0), [3, 4, 5])) == [9, 16, 25]


def hangs_once(path):
    """Tick, and wait for ever where nobody has before."""
    tick()
    with suppress(FileExistsError):
        path.touch(exist_ok=False)
        time.sleep(10**6)
    return path.name


def test_a_worker_that_hangs_is_replaced_and_its_item_done(tmp_path, caplog):
    ticks = []
    with caplog.at_level(logging.WARNING), Pool(2, silent_s=2.0) as pool:
        done = pool.map(hangs_once, [tmp_path / "a", tmp_path / "b"], ticked=ticks.append)
        assert sorted(done) == ["a", "b"]
    assert len(caplog.messages) == 2
    assert all("neither ticked nor finished for 2 s" in message for message in caplog.messages)
    assert ticks[-1] == 2


def works(seconds):
    """Tick now and then."""
    for _ in range(5):
        time.sleep(seconds / 5)
        tick()


def test_a_worker_that_ticks_is_not_silent(caplog):
    with caplog.at_level(logging.WARNING), Pool(1, silent_s=2.0) as pool:
        assert list(pool.map(works, [0.1, 4.0])) == [None, None]
    assert caplog.messages == []


def test_a_death_within_a_tick_keeps_nobody_waiting(tmp_path):
    ticks = []
    with Pool(2) as pool:
        assert list(pool.map(dies_while_it_ticks, [tmp_path / "a", tmp_path / "b"], ticked=ticks.append)) == [None] * 2
    assert ticks == sorted(ticks)


def test_an_idle_worker_that_died_is_replaced():
    with Pool(1) as pool:
        assert list(pool.map(square, [2])) == [4]
        (worker,) = multiprocessing.active_children()
        os.kill(worker.pid, signal.SIGKILL)
        worker.join()
        assert list(pool.map(square, [3])) == [9]


def test_a_worker_outlives_the_thread_that_started_it():
    first = []
    with Pool(1) as pool:
        starting = threading.Thread(target=lambda: first.extend(pool.map(pid, [0])))
        starting.start()
        starting.join()
        time.sleep(0.3)  # the thread's end follows that of its work
        assert list(pool.map(pid, [0])) == first


def test_a_worker_does_not_outlive_its_parent_whatever_it_does(tmp_path):
    marker = tmp_path / "worker"
    code = (
        "import pathlib, sys\n"
        "from test_processes import Pool, holds_the_interpreter\n"
        "if __name__ == '__main__':\n"
        "    list(Pool(1).map(holds_the_interpreter, [pathlib.Path(sys.argv[1])]))\n"
    )
    (tmp_path / "pool.py").write_text(code)
    with subprocess.Popen(
        [sys.executable, tmp_path / "pool.py", marker], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ) as parent:
        wait_until(lambda: marker.exists() and marker.read_text(), parent)
        time.sleep(0.2)
        parent.kill()
    worker = Path("/proc", marker.read_text())
    try:
        wait_until(lambda: not worker.exists())
    finally:
        if worker.exists():
            os.kill(int(worker.name), signal.SIGKILL)


def wait_until(holds, process=None):
    end = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < end
        assert process is None or process.poll() is None
        time.sleep(0.02)


def test_an_error_ends_the_work_and_says_where():
    with Pool(2) as pool, pytest.raises(DatasetError, match=r"^item 7 is bad$") as raised:
        list(pool.map(raises, [7]))
    assert "in raises" in str(raised.value.__cause__)
    assert multiprocessing.active_children() == []
    with Pool(1) as pool, pytest.raises(TypeError, match="cannot pickle"):
        list(pool.map(gives_a_lock, [0]))


def test_every_worker_is_set_up_in_its_environment():
    with Pool(2, setup=partial(get_ready, 5), environment={"SIMGRAB_TEST": "1"}) as pool:
        assert set(pool.map(what_is_ready, range(4))) == {(5, "1")}
    assert "SIMGRAB_TEST" not in os.environ
    with Pool(1, setup=refuse) as pool, pytest.raises(DatasetError, match=r"^no renderer$"):
        list(pool.map(square, [1]))


def test_workers_know_their_number():
    with Pool(2) as pool:
        assert set(pool.map(number, range(8))) == {"0", "1"}
    assert PLACE not in os.environ


def test_work_that_is_left_alone_ends():
    with Pool(2) as pool, closing(pool.map(naps, [0, 1, 1])) as done:
        next(done)
        assert multiprocessing.active_children()
    assert multiprocessing.active_children() == []


def test_a_worker_that_is_asked_to_end_cleans_up_and_ignores_interrupts(tmp_path):
    interrupted = []

    def ask():
        try:
            wait_until((tmp_path / "begun").exists)
            for number in (signal.SIGINT, signal.SIGHUP):
                send(number)
            time.sleep(0.3)
            interrupted.append((tmp_path / "clean").exists())
        finally:
            send(signal.SIGTERM)

    def send(number):
        for worker in multiprocessing.active_children():
            os.kill(worker.pid, number)

    asking = threading.Thread(target=ask)
    asking.start()
    with Pool(1) as pool:
        assert list(pool.map(cleans_up, [tmp_path])) == [None]
    asking.join()
    assert interrupted == [False]
    assert (tmp_path / "clean").exists()

"""A command that is asked to end leaves nothing half done, and says by its status that it was."""

import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import SMALL, as_options

WAITS = """
import pathlib, sys, time
import click
from simgrab.cli import main
from simgrab.io.files import drafted

@click.command()
@click.argument("path", type=click.Path(path_type=pathlib.Path))
@click.argument("cleaning", type=float)
def waits(path, cleaning):
    with drafted(path) as draft:
        draft.write_text("half")
        try:
            (path.parent / "begun").touch()
            time.sleep(600)
        finally:
            (path.parent / "cleaning").touch()
            time.sleep(cleaning)
            (path.parent / "clean").touch()

main(waits)
"""
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


def start(tmp_path, cleaning=0, code=WAITS):
    command = [sys.executable, "-c", code, str(tmp_path / "a.txt"), str(cleaning)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_for(tmp_path / "begun", process)
    return process


def wait_for(path, process):
    while not path.exists():
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)


@pytest.mark.parametrize(
    "number", [pytest.param(one, marks=[] if one == signal.SIGINT else pytest.mark.slow) for one in STATUS]
)
def test_a_signal_ends_a_command_as_an_interrupt_does(tmp_path, number):
    process = start(tmp_path)
    process.send_signal(number)
    process.send_signal(number)  # as `timeout` does
    _, said = process.communicate()
    assert process.returncode == STATUS[number]
    assert said.strip() == "simgrab: interrupted"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["begun", "clean", "cleaning"]


def test_an_interrupted_command_does_not_wait_for_a_librarys_thread(tmp_path):
    thread = "__import__('threading').Thread(target=time.sleep, args=(600,)).start(); time.sleep(600)"
    process = start(tmp_path, code=WAITS.replace("time.sleep(600)", thread))
    process.send_signal(signal.SIGTERM)
    try:
        process.communicate(timeout=120)
        assert process.returncode == 143
        assert (tmp_path / "clean").exists()
    finally:
        process.kill()


@pytest.mark.slow
def test_a_second_signal_ends_it_at_once(tmp_path):
    process = start(tmp_path, cleaning=600)
    process.send_signal(signal.SIGINT)
    wait_for(tmp_path / "cleaning", process)
    time.sleep(1.2)
    process.send_signal(signal.SIGTERM)
    process.communicate()
    assert process.returncode == 143
    assert not (tmp_path / "clean").exists()


def test_a_second_signal_ends_a_library_that_computes(tmp_path):
    in_c = WAITS.replace("time.sleep(600)", "__import__('hashlib').pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)")
    process = start(tmp_path, code=in_c)
    try:
        time.sleep(0.2)
        process.send_signal(signal.SIGTERM)
        time.sleep(1.2)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 143


REPORTS = """
import os, signal, sys, time
import click
from simgrab import cli
from simgrab.errors import RunError

def interrupted(report):
    def inner(*arguments):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        report(*arguments)
    return inner

cli.{step} = interrupted(cli.{step})

@click.command()
def ends():
    {end}

cli.main(ends)
"""


@pytest.mark.parametrize(
    ("step", "end"),
    [("_report", "raise RunError('a folder is in the way')"), ("_drop_unprintable", "print('done')")],
)
def test_a_signal_while_the_end_is_reported_gives_no_traceback(step, end):
    code = REPORTS.format(step=step, end=end)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.returncode == {"_report": 143, "_drop_unprintable": 0}[step]


@pytest.mark.slow
def test_what_was_ignored_stays_ignored(tmp_path):
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    process = start(tmp_path, code=ignoring + WAITS)
    process.send_signal(signal.SIGHUP)
    time.sleep(0.2)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    process.communicate()
    assert process.returncode == 143


@pytest.mark.slow
def test_a_rendering_ends_with_its_workers(tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "simgrab", "render", "quay-day", *as_options(SMALL | {"frames": 400})]
    command += ["--out", str(out), "--workers", "2", "--quiet"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and not any((out / ".partial" / "rows").glob("*.json")):
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGTERM)  # as a service's end does
    _, said = process.communicate()  # until the last process has let go of stderr
    assert process.returncode == 143
    assert said.strip() == f"simgrab: interrupted; run the same command with --resume to continue in {out}"
    assert any((out / ".partial" / "rows").iterdir())

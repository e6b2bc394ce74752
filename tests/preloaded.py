"""Runs commands of simgrab and scripts of Python as fresh processes that need not import simgrab again.

``python -m tests.preloaded`` imports much, and then forks a process for each line of its input, which has the line's
command and folder. The parent opens no OpenGL context and starts no net, so that the child is as a new process.
"""

import json
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path

IMPORTED = (
    "scipy.signal",
    "simgrab.cli.audit",
    "simgrab.cli.check",
    "simgrab.cli.detect",
    "simgrab.cli.grab",
    "simgrab.cli.render",
    "simgrab.cli.stress",
    "simgrab.instrument.detect",
    "simgrab.instrument.pipeline",
    "simgrab.instrument.run.run",
    "simgrab.judge.audit.audit",
    "simgrab.judge.check.gate",
    "simgrab.judge.evaluate.evaluation",
    "simgrab.judge.own_grab",
    "simgrab.judge.stress.catalogue",
    "simgrab.judge.stress.page",
    "simgrab.labels.shards",
    "simgrab.pages.plots",
    "simgrab.world.output.dataset",
)


class Commands:
    """The process that runs them; a context manager."""

    def __enter__(self):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.preloaded"],
            cwd=Path(__file__).parents[1],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *_):
        self._process.communicate()

    def run(self, command, folder):
        """Exit status, output and error output of ``simgrab …`` or ``python FILE …``."""
        self._process.stdin.write(json.dumps([command, str(folder)]) + "\n")
        self._process.stdin.flush()
        return tuple(json.loads(self._process.stdout.readline()))


def _child(command, folder, output, errors):
    status = 1
    try:
        os.chdir(folder)
        for number, file in ((0, os.open(os.devnull, os.O_RDONLY)), (1, output), (2, errors)):
            os.dup2(file, number)
        _become(command)
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _become(command):
    program, *arguments = command
    if program == "python":
        sys.argv, sys.path[0] = arguments, str(Path.cwd())
        runpy.run_path(arguments[0], run_name="__main__")
    else:
        from simgrab.cli import main

        sys.argv, sys.path[0] = command, str(Path(sys.executable).parent)  # not the working folder, as when installed
        main()


def _serve():
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for module in IMPORTED:
        __import__(module)
    for line in sys.stdin:
        command, folder = json.loads(line)
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
            pid = os.fork()
            if pid == 0:
                _child(command, folder, output.fileno(), errors.fileno())
            _, status = os.waitpid(pid, 0)
            streams = [stream.seek(0) or stream.read().decode(errors="replace") for stream in (output, errors)]
        answers.write(json.dumps([os.waitstatus_to_exitcode(status), *streams]) + "\n")
        answers.flush()


if __name__ == "__main__":
    _serve()

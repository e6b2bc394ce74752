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
    "scipy.signal simgrab.cli.audit simgrab.cli.check simgrab.cli.detect simgrab.cli.render simgrab.cli.stress "
    "simgrab.cli.train simgrab.cli.grab simgrab.judge.stress.catalogue simgrab.judge.stress.page "
    "simgrab.judge.audit.audit simgrab.judge.check.gate simgrab.instrument.pipeline simgrab.instrument.run.run "
    "simgrab.judge.evaluate.evaluation simgrab.judge.own_grab simgrab.world.output.dataset simgrab.instrument.detect "
    "simgrab.labels.shards simgrab.pages.plots"
).split()


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


def _become(command, output, errors):
    os.dup2(output, 1)
    os.dup2(errors, 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    program, *arguments = command
    sys.argv = [arguments[0], *arguments[1:]] if program == "python" else command
    if program == "python":
        sys.path[0] = str(Path.cwd())
        runpy.run_path(arguments[0], run_name="__main__")
    else:
        from simgrab.cli import main

        sys.path[0] = str(Path(sys.executable).parent)  # as for the installed command: not the working folder
        main()


def _serve():
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for module in IMPORTED:
        __import__(module)
    for line in sys.stdin:
        command, folder = json.loads(line)
        (read, write), errors = os.pipe(), tempfile.TemporaryFile()
        pid = os.fork()
        if pid == 0:
            os.close(read)
            status = 1
            try:
                os.chdir(folder)
                _become(command, write, errors.fileno())
                status = 0
            except SystemExit as end:
                status = end.code if isinstance(end.code, int) else int(end.code is not None)
            except BaseException:
                sys.excepthook(*sys.exc_info())
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        os.close(write)
        with os.fdopen(read, encoding="utf-8", errors="replace") as output:
            text = output.read()
        _, status = os.waitpid(pid, 0)
        errors.seek(0)
        printed = errors.read().decode(errors="replace")
        answers.write(json.dumps([os.waitstatus_to_exitcode(status), text, printed]) + "\n")
        answers.flush()


if __name__ == "__main__":
    _serve()

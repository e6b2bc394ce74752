"""The command line: one file a verb, each of which parses, calls one public function, and prints."""

from __future__ import annotations

import io
import os
import signal
import sys
import warnings
from contextlib import suppress
from typing import NoReturn

import click

from simgrab._version import __version__
from simgrab.cli._signals import stoppable
from simgrab.cli._verbs import Verbs
from simgrab.errors import SimgrabError, first_line, memory_problem, shortened
from simgrab.text import printable

_INTERRUPTED = 128 + signal.SIGINT


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simgrab")
def cli() -> None:
    """Render labelled frames of a swinging crane grab, and measure and evaluate its swing."""


def main(command: click.Command = cli) -> NoReturn:
    """Run the command line. Characters that the terminal's encoding lacks are printed as escapes.

    Exit status: 0 done; 1 a check failed, or nothing was measured; 2 bad input; 128 + the signal's number after an
    interrupt (130 for Ctrl-C).
    """
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # its own crashes where memory is limited
    warnings.filterwarnings("ignore", module="PIL")  # of damaged EXIF
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with stoppable() as received:
        try:
            status = _status(command)
        except KeyboardInterrupt:  # it came while something else was reported; there is no second one
            status = _INTERRUPTED
        if status == _INTERRUPTED and received.number is not None:
            status = 128 + received.number
        with suppress(KeyboardInterrupt):
            _drop_unprintable()
        if received.number is not None:
            os._exit(status)  # threads of libraries that still compute may crash as the interpreter ends
        sys.exit(status)


def _open_closed_streams() -> None:
    """Open the null device in place of a closed standard stream.

    Else a file would take its number, into which libraries and worker processes would print.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the least number that is free


def _status(command: click.Command) -> int:
    """Run a command, and report an error in one line."""
    try:
        status = command(prog_name="simgrab" if command is cli else None, standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
        return status or 0
    except click.exceptions.NoArgsIsHelpError as nothing:
        nothing.show()
        return nothing.exit_code
    except click.ClickException as problem:
        context = getattr(problem, "ctx", None)
        advice = f"; see {context.command_path} --help" if context else ""
        _report(" ".join(problem.format_message().split()).removesuffix(".") + advice)
        return problem.exit_code
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException as problem:
        # click raises Abort for an interrupt, and for an EOFError as well.
        cause = (problem.__cause__ or problem) if isinstance(problem, click.Abort) else problem
        line, status = _answer(cause)
        if line is None:
            raise cause from None
        if line:
            _report("; ".join((line, *getattr(cause, "__notes__", ()))))
        return status


def _answer(problem: BaseException) -> tuple[str | None, int]:
    """Return the error line (may be empty; None for a fault of simgrab) and the exit status."""
    if _is_interrupted(problem):  # whatever came of it: a terminal may be gone
        return "interrupted", _INTERRUPTED
    if isinstance(problem, BrokenPipeError):
        return "", 1
    return (_line(problem) if isinstance(problem, Exception) else None), 2


def _is_interrupted(problem: BaseException | None) -> bool:
    while problem is not None and not isinstance(problem, KeyboardInterrupt | click.Abort):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


def _report(line: str) -> None:
    with suppress(OSError):  # nobody may be there to read it
        click.echo(shortened(printable(f"simgrab: {line}")), err=True)


def _drop_unprintable() -> None:
    """Drop output that cannot be printed. Python would report it again at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _line(problem: Exception) -> str | None:
    """Describe an error in one line; None for a fault of simgrab."""
    if isinstance(problem, SimgrabError):
        return str(problem)
    memory = memory_problem(problem)
    if memory is not None:
        return f"out of memory ({memory})"
    if isinstance(problem, OSError):  # the disk is full, or a folder is gone
        where = "" if problem.filename is None else f"{problem.filename}: "
        return f"{where}{problem.strerror or problem}"
    if type(problem).__module__ == "av.error":
        return f"FFmpeg failed: {first_line(problem)}"
    return None

"""The command line: one file a verb, each of which parses, calls one public function, and prints."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from typing import NoReturn

import click

from simgrab import __version__
from simgrab.errors import SimgrabError


class Verbs(click.Group):
    """Finds a verb in the module of its name, and imports no other."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002, D102
        return sorted(m.name for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: D102
        if cmd_name not in self.list_commands(ctx):
            return None
        command = importlib.import_module(f"{__name__}.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="simgrab")
def cli() -> None:
    """Frames of a swinging crane grab in which the swing is known, because it was set."""


def main(command: click.Command = cli) -> NoReturn:
    """Run the command line. Exit status: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    try:
        status = command(standalone_mode=False)
    except click.ClickException as problem:
        problem.show()
        sys.exit(problem.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("simgrab: interrupted", err=True)
        sys.exit(130)
    except SimgrabError as problem:
        click.echo(f"simgrab: {problem}", err=True)
        sys.exit(2)
    except MemoryError as problem:
        click.echo(f"simgrab: out of memory ({str(problem) or 'no more could be had'})", err=True)
        sys.exit(2)
    except BrokenPipeError:
        sys.exit(1)
    except OSError as problem:  # the disk is full, or a folder is gone
        where = "" if problem.filename is None else f"{problem.filename}: "
        click.echo(f"simgrab: {where}{problem.strerror or problem}", err=True)
        sys.exit(2)
    sys.exit(status or 0)

"""The command line in this process."""

from click.testing import CliRunner

from simgrab.cli import cli
from simgrab.errors import SimgrabError


def run(*arguments):
    """Run the command line in this process: its exit status, what it printed, and what it complained of."""
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    if isinstance(result.exception, SimgrabError):
        return 2, result.stdout, f"simgrab: {result.exception}\n"
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr

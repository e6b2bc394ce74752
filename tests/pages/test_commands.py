"""`simgrab browse` and `simgrab studio` print their address, serve, and end at an interrupt without a word."""

import os
import re
import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

from simgrab.cli import cli

ADDRESS = r"http://127\.0\.0\.1:\d+/\?token=[\w-]+\n"


@pytest.fixture(params=["browse", "studio"])
def command(request, split_dataset, tmp_path):
    """The command's arguments, and what it calls what it shows."""
    if request.param == "browse":
        return ["browse", str(split_dataset), "--no-open"], f"12 frames of {split_dataset}"
    scene = tmp_path / "yard.toml"
    scene.write_text('camera = { width_px = 320, height_px = 180 }\nplace = { model = "plain" }\n')
    return ["studio", str(scene), "--no-open"], str(scene)


def test_it_prints_the_address_and_ends_at_an_interrupt(command, monkeypatch):
    arguments, title = command
    asked = []

    def interrupted():
        asked.append("")
        raise KeyboardInterrupt

    monkeypatch.setattr(signal, "pause", interrupted)
    result = CliRunner().invoke(cli, arguments)
    assert asked
    assert result.exit_code == 0
    assert re.fullmatch(f"{re.escape(title)}: {ADDRESS}", result.stdout)


@pytest.mark.slow
def test_a_signal_ends_it_without_a_word(command):
    arguments, title = command
    number = {"browse": signal.SIGINT, "studio": signal.SIGTERM}[arguments[0]]
    run = [sys.executable, "-m", "simgrab", *arguments]
    with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline().startswith(f"{title}: http://127.0.0.1:")
        os.kill(process.pid, number)
        _, said = process.communicate(timeout=30)
    assert process.returncode in (0, 128 + number)
    assert "Traceback" not in said

"""The steps of the GitHub Action run: their commands, with the inputs' defaults, in the folder of a tiny suite."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
STEPS = ACTION["runs"]["steps"]
SUITE = """
name = "tiny"
instrument = "mine:Mine"
size = "480x270"
[changes]
place = { model = "plain" }
image = { samples = 0, shadow_map_px = 0 }
display = { layout = "two-by-four" }
[limits]
"frames.ok" = { lower = 1 }
[scenes.calm]
scene = "calm-day"
frames = 2
"""
PIPELINE = """
from simgrab.instrument.contract import Measurement
class Mine:
    name, status = "mine", "ok"
    def __call__(self, frames, calibration):
        return [Measurement(status=self.status, alpha=0.05 if self.status == "ok" else None) for _ in frames]
class Blind(Mine):
    status = "missed"
"""
INSTALLERS = ("sudo", "python")  # whose arguments are noted in place of installing


def value(text, inputs):
    """Fill expressions in as GitHub does; an input that action.yml does not declare fails."""
    known = {f"inputs.{name}": str(value) for name, value in inputs.items()} | {"github.action_path": str(ROOT)}
    return re.sub(r"\$\{\{ (.*?) \}\}", lambda found: known[found[1]], text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "status", "message"),
    [
        ({}, 0, "tiny, seed 0: mine passed"),
        ({"instrument": "mine:Blind", "seed": "3", "out": "results of CI"}, 1, "tiny, seed 3: mine failed"),
    ],
)
def test_the_actions_steps_run(given, status, message, tmp_path):
    inputs = {name: about.get("default") for name, about in ACTION["inputs"].items()} | {"suite": "tiny.toml"} | given
    (tmp_path / "tiny.toml").write_text(SUITE)
    (tmp_path / "mine.py").write_text(PIPELINE)
    (tmp_path / "bin").mkdir()
    for name in INSTALLERS:
        path = tmp_path / "bin" / name
        path.write_text(f'#!/bin/sh\necho {name} "$@" >> "{tmp_path}/installed"\n')
        path.chmod(0o755)
    search = os.pathsep.join([str(tmp_path / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]])
    here = os.environ | {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / ".cache"), "PATH": search}
    results = []
    for step in (step for step in STEPS if "run" in step):
        command = [step["shell"], "--noprofile", "--norc", "-eo", "pipefail", "-c", value(step["run"], inputs)]
        env = here | {name: value(text, inputs) for name, text in step["env"].items()}
        results.append(
            subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300, check=False)
        )
    assert [result.returncode for result in results] == [0, status], results[-1].stderr
    assert message in results[-1].stdout
    installed = (tmp_path / "installed").read_text().splitlines()
    assert installed[-1] == f"python -m pip install --quiet {ROOT}"
    (packages,) = (line.split("--no-install-recommends ")[1] for line in installed if " install -y" in line)
    assert f"apt-get install -y {packages}" in (ROOT / "docs" / "checking.md").read_text(encoding="utf-8")
    cached, kept = (next(s for s in STEPS if s.get("uses", "").startswith(f"actions/{name}")) for name in
                    ("cache", "upload-artifact"))  # fmt: skip
    assert list((tmp_path / cached["with"]["path"].removeprefix("~/")).iterdir())
    assert (tmp_path / value(kept["with"]["path"], inputs) / "check.html").is_file()
    assert kept["if"] == "always()"

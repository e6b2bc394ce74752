"""On what a run of `scripts.bench` measured: commit, date, machine and versions."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from scripts.bench_results import Quantity, Results
from simgrab.judge import doctor
from simgrab.runtime import machine

ROOT = Path(__file__).parents[1]
FURTHER_PACKAGES = ("onnxruntime", "av")  # whose speed is measured, beside those that `simgrab doctor` lists


def of_this_run(verb: str, options: dict[str, Any], quantities: tuple[Quantity, ...]) -> Results:
    """Add to what was measured the commit, the date, the machine and the versions of packages."""
    diagnosis = doctor.examine()
    versions = dict(diagnosis.versions)
    for package in FURTHER_PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    renderer = diagnosis.renderer
    versions["passes"] = renderer.passes if renderer else ""  # "1 whole": SIMGRAB_REUSE=0
    described = {
        "cpu": _cpu(),
        "cores": str(machine.cores()),
        "memory": f"{psutil.virtual_memory().total / 1e9:.0f} GB",
        "opengl": f"{renderer.renderer}, {renderer.version}" if renderer else f"none: {diagnosis.problem}",
        "backend": os.environ["MUJOCO_GL"],
        "system": platform.platform(),
    }
    plain = {name: str(value) if isinstance(value, Path) else value for name, value in options.items()}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return Results(verb, plain, _commit(), date, described, versions, quantities)


def _cpu() -> str:
    """Model of the CPU, which `platform.processor` leaves empty on most Linux systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _commit() -> str:
    git = ["git", "-C", str(ROOT)]
    try:
        commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD"], capture_output=True, check=False).returncode
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit}+" if changed else commit

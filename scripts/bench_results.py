"""What a run of `scripts.bench` measured, on what, and how it is kept as JSON."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import psutil

from simgrab.errors import SimgrabError
from simgrab.judge import doctor
from simgrab.utilities import files, machine
from simgrab.utilities.parse import read_json
from simgrab.utilities.strict import convert

ROOT = Path(__file__).parents[1]
FURTHER_PACKAGES = ("onnxruntime", "av")  # whose speed is measured, beside those that `simgrab doctor` lists


class ResultsError(SimgrabError):
    """A file of results that cannot be read or written, or two that cannot be compared."""


class Quantity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One quantity with all its samples, in the order in which they were measured.

    Attributes
    ----------
    name, unit : str
    samples : tuple of float
    by : str
        Program that was measured, with its version, where it is not simgrab or among `Results.versions`.
    """

    name: str
    unit: str
    samples: Annotated[tuple[float, ...], msgspec.Meta(min_length=1)]
    by: str = ""

    @property
    def median(self) -> float:
        """Of the samples."""
        return float(np.median(self.samples))

    def __str__(self) -> str:
        text = f"{self.name:44s} {self.median:10.4g} {self.unit}"
        if len(self.samples) > 1:
            low, high = np.percentile(self.samples, [10, 90])
            mean = np.mean(self.samples)
            text += f" (median of {len(self.samples)}; 10–90 %: {low:.4g}–{high:.4g}; mean {mean:.4g})"
        return text


class Results(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One run.

    Attributes
    ----------
    verb : str
    options : dict
        Of the command line.
    commit : str
        Of this checkout; ends in ``+`` where tracked files were changed.
    date : str
        UTC, ISO 8601.
    machine, versions : dict of str to str
    quantities : tuple of Quantity
    """

    verb: str
    options: dict[str, Any]
    commit: str
    date: str
    machine: dict[str, str]
    versions: dict[str, str]
    quantities: tuple[Quantity, ...]

    def __post_init__(self) -> None:
        names = [quantity.name for quantity in self.quantities]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"quantities has more than one {min(twice)!r}")

    def save(self, path: Path) -> None:
        """Write as JSON, in place of a file that is there."""
        try:
            files.write(path, msgspec.json.format(msgspec.json.encode(self), indent=1))
        except OSError as problem:
            raise ResultsError(f"cannot write {path}: {problem.strerror}") from None


def load(path: Path) -> Results:
    """Read what `Results.save` wrote.

    Raises
    ------
    ResultsError
        In one line, with the file and the key.
    """
    return convert(read_json(path, ResultsError, "results of a benchmark"), Results, ResultsError, path)


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

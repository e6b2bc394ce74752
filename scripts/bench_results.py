"""What a run of `scripts.bench` measured, on what, how it is kept as JSON, and how two runs are compared."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import psutil

from simgrab.errors import SimgrabError
from simgrab.io import files
from simgrab.io.parse import read_json
from simgrab.io.strict import convert
from simgrab.model.rng import stream
from simgrab.runtime import machine

ROOT = Path(__file__).parents[1]
FURTHER_PACKAGES = ("onnxruntime", "av")  # whose speed is measured, beside those that `simgrab doctor` lists
RESAMPLES = 2000


class ResultsError(SimgrabError):
    """A file of results that cannot be read or written, or two that cannot be compared."""


class Quantity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One quantity with all its samples, in the order in which they were measured."""

    name: str
    unit: str
    samples: Annotated[tuple[float, ...], msgspec.Meta(min_length=1)]

    @classmethod
    def of(cls, name: str, unit: str, *samples: float) -> Quantity:
        """Make one of numbers of any kind."""
        return cls(name, unit, tuple(map(float, samples)))

    @classmethod
    def ms(cls, name: str, seconds: Iterable[float]) -> Quantity:
        """Make one of times, which are given in seconds."""
        return cls.of(name, "ms", *(1e3 * one for one in seconds))

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
    """One run: its verb and options, commit (ends in ``+`` where tracked files were changed) and UTC date."""

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

    @classmethod
    def of_this_run(cls, verb: str, options: dict[str, Any], quantities: Iterable[Quantity]) -> Results:
        """Add to what was measured the commit, the date, the machine and the versions of packages."""
        from simgrab.judge import doctor  # after measuring, because it opens renderers

        diagnosis = doctor.examine()
        renderer = diagnosis.renderer
        described = {
            "cpu": _cpu(),
            "cores": str(machine.cores()),
            "memory": f"{psutil.virtual_memory().total / 1e9:.0f} GB",
            "opengl": f"{renderer.renderer}, {renderer.version}" if renderer else f"none: {diagnosis.problem}",
            "backend": os.environ["MUJOCO_GL"],
            "system": platform.platform(),
        }
        versions = dict(diagnosis.versions) | {package: version(package) for package in FURTHER_PACKAGES}
        versions["passes"] = renderer.passes if renderer else ""  # "1 whole": SIMGRAB_REUSE=0
        plain = {name: str(value) if isinstance(value, Path) else value for name, value in options.items()}
        date = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(verb, plain, _commit(), date, described, versions, tuple(quantities))

    def save(self, path: Path) -> None:
        """Write as JSON, in place of a file that is there."""
        try:
            files.write(path, msgspec.json.format(msgspec.json.encode(self), indent=1))
        except OSError as problem:
            raise ResultsError(f"cannot write {path}: {problem.strerror}") from None


def load(path: Path) -> Results:
    """Read what `Results.save` wrote, or raise `ResultsError` in one line, with the file and the key."""
    return convert(read_json(path, ResultsError, "results of a benchmark"), Results, ResultsError, path)


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


def compare(a: Results, b: Results) -> Iterator[str]:
    """Yield lines: in what the runs differ, then each quantity's medians and the ratio of B's to A's.

    The interval is a percentile bootstrap: it holds 95 % of the ratios of medians when each run's samples are drawn
    again with replacement. It covers the spread within two runs, and not how much further runs would differ.

    Raises `ResultsError` if the runs share no quantity, or name one in different units.
    """
    ours, theirs = ({quantity.name: quantity for quantity in results.quantities} for results in (a, b))
    shared = [name for name in ours if name in theirs]
    if not shared:
        raise ResultsError(f"nothing to compare: A holds quantities of {a.verb!r}, B of {b.verb!r}")
    for name, results in (("A", a), ("B", b)):
        yield f"{name}: {results.verb} at {results.commit[:7] + results.commit[40:]}, {results.date}"
    for kind in ("machine", "versions", "options"):
        one, other = getattr(a, kind), getattr(b, kind)
        for key in sorted(one.keys() | other.keys()):
            if one.get(key) != other.get(key):
                yield f"different {kind}: {key}: {one.get(key, 'absent')} in A, {other.get(key, 'absent')} in B"
    width = max(map(len, shared))
    yield f"{'':{width}s} {'A':>10s} {'B':>10s}  B / A (95 %)"
    for name in shared:
        x, y = ours[name], theirs[name]
        if x.unit != y.unit:
            raise ResultsError(f"{name!r} is in {x.unit} in A and in {y.unit} in B")
        yield f"{name:{width}s} {x.median:10.4g} {y.median:10.4g}  {_shown(x, y)}  {x.unit}"
    for name, these in (("A", ours), ("B", theirs)):
        if alone := [key for key in these if key not in shared]:
            yield f"only in {name}: {', '.join(alone)}"


def ratio(one: Quantity, other: Quantity) -> tuple[float, float, float]:
    """Return the other's median over one's, and the ends of its interval; all samples must be positive."""
    rng = stream(0, 0, "bench compare")
    below, above = (
        np.median(rng.choice(quantity.samples, (RESAMPLES, len(quantity.samples))), axis=1) for quantity in (one, other)
    )
    low, high = np.percentile(above / below, [2.5, 97.5])
    return other.median / one.median, float(low), float(high)


def _shown(one: Quantity, other: Quantity) -> str:
    if min(*one.samples, *other.samples) <= 0:
        return "no ratio: samples of 0 or less"
    middle, low, high = ratio(one, other)
    counts = len(one.samples), len(other.samples)
    if 1 in counts:
        return f"{middle:.3f} (no spread: one sample)"
    return f"{middle:.3f} ({low:.3f}–{high:.3f}; n = {counts[0]} and {counts[1]})"

"""What a run of `scripts.bench` measured, and how it is kept as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from simgrab.errors import SimgrabError
from simgrab.io import files
from simgrab.io.parse import read_json
from simgrab.io.strict import convert


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

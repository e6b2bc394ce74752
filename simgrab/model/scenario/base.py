"""Bases of the tables of a scenario."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, ClassVar, Literal, Self

import msgspec

from simgrab.errors import ScenarioError
from simgrab.io.strict import Checked
from simgrab.io.strict import about as about

Meta = msgspec.Meta
Share = Annotated[float, Meta(ge=0, le=1)]
Rgb = tuple[Share, Share, Share]
Azimuth = Annotated[float, Meta(ge=-360, le=360)]
"""Counter-clockwise from outboard, seen from above, degrees."""
Cargo = Literal["coal", "ore", "grain", "bauxite", "sulphur"]
File = Annotated[str, Meta(min_length=1, max_length=4096)]
Sha256 = Annotated[str, about("SHA-256 of the content; filled in when it is read.", pattern=r"^([0-9a-f]{64})?\Z")]

UNITS = {
    "pixels_per_mm": "px/mm", "deg_per_m": "°/m", "mbit_s": "Mbit/s", "deg_s": "°/s", "m_min": "m/min", "m_s2": "m/s²",
    "mm_h": "mm/h", "percent": "%", "stops": "stops", "m_s": "m/s", "rpm": "1/min", "ppm": "ppm", "deg": "°",
    "px": "px", "mm": "mm", "m2": "m²", "m3": "m³", "hz": "Hz", "ms": "ms", "kg": "kg", "db": "dB", "ev": "stops",
    "m": "m", "s": "s", "e": "electrons",
}  # fmt: skip
"""What the end of a key's name says of its unit, longest first."""


def unit_of(key: str) -> str:
    """Give the unit of a key, which is the suffix of its name; empty where it has none.

    Examples
    --------
    >>> unit_of("beta_deg"), unit_of("hoist_m_s2"), unit_of("wear")
    ('°', 'm/s²', '')
    """
    return next((unit for suffix, unit in UNITS.items() if f"_{key}".endswith(f"_{suffix}")), "")


class Strict(Checked, frozen=True):
    """Base of every table."""


class Tagged(Strict, frozen=True, tag_field="model"):
    """Base of every table that comes in kinds, distinguished by ``model``."""


class OfFile:
    """What tables have that name a file of the user's: by its path, absolute or from the scene file's folder."""

    __slots__ = ()
    reader: ClassVar[ModuleType]
    """Module that reads such files."""
    file: str
    sha256: str

    @classmethod
    def of(cls, path: str | Path, **keys: Any) -> Self:
        """Read the file; ``keys`` are the other fields.

        Raises `ScenarioError` if it cannot be read, or the keys do not fit.
        """
        model = cls.reader.read(path, lambda problem: ScenarioError("file", problem))
        return cls(**{"file": model.name, "sha256": model.sha256, **keys})

    def check(self) -> None:
        """Refuse a file that was not read; none is opened here, because a stranger's scene becomes such a table too."""
        if not self.sha256 or Path(self.file).name != self.file:
            raise ScenarioError(
                "file", f"it is read by simgrab.load, from a scene file, or by {type(self).__name__}.of"
            )

"""Does a check see what it is for? ``python -m scripts.planted_faults [SUITE]``: by default `smoke`.

Checks the bundled instrument, and then the same with one fault each, against the suite's baseline, and prints which
metric stopped it. Exits with 1 if a fault passes, or the sound instrument does not.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import click
import numpy as np

from simgrab.instrument.contract import Instrument, Picture
from simgrab.instrument.detect import Detector
from simgrab.instrument.pipeline import Pipeline, bundled
from simgrab.instrument.read import Reader
from simgrab.judge.check import baseline, cache, gate, suite
from simgrab.records.observations import Detection

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from faults import LongLens, Mirrored  # type: ignore[import-not-found]

SHIFT_PX = 2.0


@dataclass(frozen=True)
class Shifted:
    """A detector that sees everything further to the right."""

    detector: Detector

    @property
    def name(self) -> str:
        """The detector's; a regression does not output one."""
        return self.detector.name

    def __call__(self, picture: Picture) -> Detection:
        """Detect, and shift."""
        found = self.detector(picture)
        if found.box is None or found.centre is None:
            return found
        right = np.array([SHIFT_PX, 0.0])
        return replace(found, box=found.box + np.tile(right, 2), centre=found.centre + right)


class Swapping(Reader):
    """A reader that takes 3 for 8, and 8 for 3."""

    def probabilities(self, entered: Any) -> Any:
        """Swap the two answers."""
        columns = np.arange(11)
        columns[[3, 8]] = 8, 3
        return super().probabilities(entered)[:, columns]


def faults(sound: Pipeline) -> dict[str, Instrument]:
    """Give the sound instrument and each fault of it."""
    return {
        "sound": sound,
        f"detector {SHIFT_PX:g} px to the right": replace(sound, detector=Shifted(sound.detector)),
        "3 read as 8": replace(sound, reader=Swapping()),
        "h 5 % off": replace(sound, estimator=LongLens()),
        "sign of gamma": replace(sound, estimator=Mirrored()),
    }


@click.command()
@click.argument("name", metavar="SUITE", default="smoke")
def main(name: str) -> None:
    """Check each, and a baseline that has gone stale."""
    found, passed = suite.load(name), {}
    options = gate.Options(baseline=Path(found.baseline), cache=cache.default())
    for what, instrument in faults(bundled()).items():
        report = gate.check(found, replace(options, instrument=instrument))
        failed = [f"{v.scene} {v.what}: {v.message}" for v in report.verdicts if v.status == "failed"]
        passed[what] = report.passed
        print(f"{what}: {'passed' if report.passed else 'failed'}", *failed, sep="\n  ")
    with mock.patch.object(baseline, "version", return_value="0.0"):
        report = gate.check(found, options)
    passed["stale baseline"] = report.passed
    print("stale baseline:", *(v.message for v in report.verdicts if v.what == "baseline"), sep="\n  ")
    sys.exit(0 if passed.pop("sound") and not any(passed.values()) else 1)


if __name__ == "__main__":
    main()

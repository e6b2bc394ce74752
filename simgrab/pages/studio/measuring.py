"""What the instrument makes of a frame: from its pixels and the camera file alone.

The swing in one frame takes the tilt of the camera, which only a record of frames gives. So frames of the same scene
are measured one by one, and the estimate gets better as they become more.
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import msgspec

from simgrab.dataset.tables import calibration_of
from simgrab.errors import ScenarioError
from simgrab.instrument.contract import Frame
from simgrab.instrument.observation import Observation, one
from simgrab.instrument.pipeline import MeasuredRecord, Pipeline, assemble
from simgrab.io import pictures
from simgrab.model.calibration import Calibration
from simgrab.model.scenario import Iid, Scenario
from simgrab.pages.studio.rendering import kept

MOST_FRAMES = 60
"""Of a record."""
_KEPT = 2  # records: those of both sides


@dataclass
class _Record:
    scenario: Scenario
    calibration: Calibration
    observations: dict[int, Observation] = field(default_factory=dict)


class Measuring:
    """Measures frames with the bundled instrument. It never sees a truth."""

    def __init__(self) -> None:
        self._records: list[tuple[Scenario, _Record]] = []
        self._turn = threading.Lock()

    def measure(self, scenario: Scenario, frame: int, rendered: Callable[[int], Future[bytes]]) -> dict[str, Any]:
        """Measure a frame; where that was done already, measure one more of its record.

        ``rendered`` begins to render the picture file of a frame, at full size.

        Returns
        -------
        dict
            Plain data, angles in degrees: the measurement of the frame, the tilt, and how much of the record is
            measured.

        Raises
        ------
        SimgrabError
            If a frame cannot be, or is none for the detector.
        """
        wanted = sorted({*record_of(scenario, frame), frame})
        with self._turn:
            record = kept(self._records, scenario, lambda: _Record(scenario, calibration_of(scenario)), _KEPT)
        left = [number for number in (frame, *wanted) if number not in record.observations]
        if left:
            number, data, lost = left[0], b"", ""
            try:
                data = rendered(number).result()
            except ScenarioError as problem:  # a frame of the record that cannot be
                if number == frame:
                    raise
                lost = str(problem)
            with self._turn:
                record.observations[number] = self._observe(record, number, data, lost)
        with self._turn:
            numbers = [number for number in wanted if number in record.observations]
            seen = [record.observations[number] for number in numbers]
            concluded = self._instrument.conclude(seen, record.calibration)
        about = {"measured": len(numbers), "wanted": len(wanted)}
        return about | _described(concluded, numbers.index(frame))

    @functools.cached_property
    def _instrument(self) -> Pipeline:
        return assemble()

    def _observe(self, record: _Record, number: int, data: bytes, lost: str) -> Observation:
        instrument, scenario = self._instrument, record.scenario
        begin = scenario.span(scenario.clip.of(number)).start
        timed = not isinstance(scenario.swing, Iid)
        seconds = (number - begin) / scenario.clip.frame_rate_hz if timed else None
        picture = None if lost else pictures.decode(data, f"frame {number}")
        return one(Frame(picture, seconds, lost), instrument.detector, instrument.reader, record.calibration)


def record_of(scenario: Scenario, frame: int) -> range:
    """Frames that are measured together with one: of its clip, evenly spread."""
    span = scenario.span(scenario.clip.of(frame))
    return span[:: max(math.ceil(len(span) / MOST_FRAMES), 1)]


def _described(record: MeasuredRecord, index: int) -> dict[str, Any]:
    measured, tilt = record.measurements[index], record.tilt
    plain: dict[str, Any] = msgspec.to_builtins(measured)
    angles = {
        f"{name}_deg": None if plain[name] is None else math.degrees(plain[name])
        for name in ("alpha", "alpha_low", "alpha_high")
    }
    return plain | angles | {"beta_deg": None if tilt is None else tilt.beta_deg}

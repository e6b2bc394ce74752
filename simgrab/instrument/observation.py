"""Observations of each frame, before any estimate: the grab's position and the display's text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from simgrab.errors import DetectorError
from simgrab.instrument.contract import Frame
from simgrab.instrument.detect import Detector
from simgrab.instrument.read import Reader
from simgrab.model.calibration import Calibration
from simgrab.model.records.observations import Detection


class Observation(msgspec.Struct, frozen=True, gc=False):
    """Observation of one frame: about a kilobyte, so that records may last hours. Pixels and metres."""

    time_s: float | None
    lost: str = ""  # why there was no picture; empty where there was one
    missed: str = ""  # why no grab was detected in it; empty where one was
    score: float = 0.0
    # box, centre, centre_sd: as in `simgrab.instrument.contract.Measurement`; the centre is the box's if the detector
    # predicts no other
    box: tuple[float, float, float, float] | None = None
    centre: tuple[float, float] | None = None
    centre_sd: tuple[float, float] | None = None
    yaw: float | None = None  # as in `simgrab.model.records.observations.Detection`
    rope_text: str | None = None
    # rope_status, rope_reason: as in `simgrab.model.records.observations.Reading`; empty if no display was to be read
    rope_status: str = ""
    rope_reason: str = ""
    hoist_m: float | None = None  # hoist rope on the display


def observe(
    frames: Iterable[Frame], detector: Detector, reader: Reader | None, calibration: Calibration
) -> Iterator[Observation]:
    """Detect the grab and read the display in each frame; without a reader or a display layout, nothing is read.

    Raises `DetectorError`, `ReaderError`, `LayoutError` if detector, reader or layout cannot use a picture, or a
    detection is invalid. A note names the frame, as that of any other error.
    """
    for i, frame in enumerate(frames):
        try:
            found = one(frame, detector, reader, calibration)
        except Exception as problem:
            problem.add_note(f"in frame {i}")
            raise
        yield found


def one(frame: Frame, detector: Detector, reader: Reader | None, calibration: Calibration) -> Observation:
    """Detect the grab and read the display in one frame."""
    if frame.picture is None:
        return Observation(frame.time_s, lost=frame.reason)
    found = detector(frame.picture)
    if wrong := _flaw(found):
        raise DetectorError(f"{detector.name}: {wrong}")
    box = centre = sd = None
    if found.found and found.box is not None:
        x0, y0, x1, y1 = (float(edge) for edge in found.box)
        box, centre = (x0, y0, x1, y1), ((x0 + x1) / 2, (y0 + y1) / 2)
    if found.found and found.centre is not None:
        centre = _pair(found.centre)
        sd = None if found.centre_sd_px is None else _pair(found.centre_sd_px)
    seen = Observation(
        frame.time_s, missed="" if found.found else found.reason or "no grab found", score=found.score,
        box=box, centre=centre, centre_sd=sd, yaw=found.yaw if found.found else None,
    )  # fmt: skip
    if reader is None or calibration.digit_layout is None:
        return seen
    read = reader.read(frame.picture, calibration.digit_layout)
    return msgspec.structs.replace(
        seen, rope_text=read.text, rope_status=read.status, rope_reason=read.reason, hoist_m=read.hoist_m
    )


def _flaw(found: object) -> str:
    """Return what is wrong with a user's detection; empty if it is valid."""
    if not isinstance(found, Detection):
        return f"expected a Detection, got {type(found).__name__}"
    if found.found and found.box is None and found.centre is None:
        return "'found' needs a box or a centre"
    for name, size in (("box", 4), ("centre", 2), ("centre_sd_px", 2)):
        value = getattr(found, name)
        if value is not None and (np.shape(value) != (size,) or not np.isfinite(value).all()):
            return f"{name}: {size} finite numbers are required, got {value}"
    return ""


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])

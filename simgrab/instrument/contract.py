"""The contract of an instrument: it takes frames and a camera, and returns one measurement for each frame."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Protocol, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.model.calibration import Calibration

Picture = NDArray[np.uint8]
Status = Literal["ok", "lost", "missed", "unread", "refused"]
Meta = msgspec.Meta
_NUMBERS = re.compile(r"([0-9?]\.?){3}[0-9?] ([0-9?]\.?){3}[0-9?]")


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a source.

    Attributes
    ----------
    picture : ndarray of uint8, shape (height, width, 3), or None
        RGB; None for a lost frame.
    time_s : float or None
        Increasing; None where frames do not follow each other in time.
    reason : str
        Why there is no picture; empty where there is one.
    name : str
        Name of the picture's file; empty in a video.
    note : str
        Assumptions on the picture or its time, or how the picture differs from the coded one; mostly empty.
    """

    picture: Picture | None
    time_s: float | None
    reason: str = ""
    name: str = ""
    note: str = ""


class Measurement(msgspec.Struct, frozen=True, kw_only=True):
    """Measurement of one frame. All but the status may be left out. Radians, metres, pixels.

    Attributes
    ----------
    status : str
        ``"ok"``: there is an α. ``"lost"``: there was no picture. ``"missed"``: no grab was found in it. ``"unread"``:
        α requires the rope's length, which is not known. ``"refused"``: any other reason.
    reason : str
        Reason; empty only if the status is ok.
    alpha : float or None
        Swing angle: between the rope and gravity; None unless ok.
    alpha_low, alpha_high : float or None
        Ends of its 95 % interval.
    direction : float or None
        Where the grab swings to, jib frame: 0 is outboard, π/2 to the left of that, seen from above; from -π to π.
    danger : float or None
        Probability that the swing exceeds 10°.
    warning : float or None
        Probability that it exceeds 10° within 6 s, now included.
    peak, peak_low, peak_high : float or None
        Expected α at the next turning point, and the ends of its 95 % interval.
    peak_in_s : float or None
        Time to the next turning point, at most 6 s.
    box : tuple of 4 floats, or None
        x0, y0, x1, y1 of the visible grab; (0, 0) is the outer corner of the top-left pixel.
    score : float
        Score of the detection, 0 to 1.
    centre : tuple of 2 floats, or None
        Position of the grab centre A in the picture.
    centre_sd : tuple of 2 floats, or None
        Its standard deviations.
    rope_text : str or None
        Text read on the display: four digits, a blank and four digits, with ``?`` for a refused digit; a number may
        contain a point.
    rope_status : str
        ``"read"``, ``"refused"`` or ``"jump"``, as in `simgrab.model.records.observations.Reading`; empty if no display
        was to be read.
    rope_length_m : float or None
        |OA| from which α was computed.
    """

    status: Status
    reason: str = ""
    alpha: Annotated[float, Meta(ge=0)] | None = None
    alpha_low: float | None = None
    alpha_high: float | None = None
    direction: Annotated[float, Meta(ge=-math.pi, le=math.pi)] | None = None
    danger: Annotated[float, Meta(ge=0, le=1)] | None = None
    warning: Annotated[float, Meta(ge=0, le=1)] | None = None
    peak: float | None = None
    peak_low: float | None = None
    peak_high: float | None = None
    peak_in_s: float | None = None
    box: tuple[float, float, float, float] | None = None
    score: Annotated[float, Meta(ge=0, le=1)] = 0.0
    centre: tuple[float, float] | None = None
    centre_sd: tuple[float, float] | None = None
    rope_text: str | None = None
    rope_status: str = ""
    rope_length_m: float | None = None


def flaw(m: Measurement) -> str:
    """Return what is wrong with a measurement beyond its types; empty if it is valid."""
    if m.status == "ok" and m.alpha is None:
        return "status 'ok' needs alpha; a frame without an angle has another status, and a reason"
    if m.status != "ok" and m.alpha is not None:
        return f"alpha is only allowed with status 'ok'; got {m.status!r}, {m.alpha}"
    if (m.status == "ok") == bool(m.reason):
        return f"a reason is required unless the status is 'ok'; got {m.status!r}, {m.reason!r}"
    for name, value in msgspec.structs.asdict(m).items():
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(x) for x in numbers if isinstance(x, float)):
            return f"{name}: {value} is not finite; leave out what is not known"
    if m.alpha is not None and m.alpha > math.pi / 2:
        return f"alpha: {m.alpha:g} rad is beyond the horizontal; angles are in radians"
    if m.alpha_low is not None and m.alpha_high is not None and m.alpha_low > m.alpha_high:
        return f"alpha_low: {m.alpha_low:g} rad is above alpha_high, {m.alpha_high:g}"
    if m.box is not None and not (m.box[0] < m.box[2] and m.box[1] < m.box[3]):
        return f"box: x0 < x1 and y0 < y1 are required, got {m.box}"
    if m.rope_text is not None and not _NUMBERS.fullmatch(m.rope_text):
        return f"rope_text: must be four digits, a space and four digits, as in '0615 09??', got {m.rope_text!r}"
    return ""


class Instrument(Protocol):
    """Measures the swing in a record of frames.

    To test a pipeline, write a factory without arguments that returns an instrument.
    """

    @property
    def name(self) -> str:
        """Name in reports."""

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record.

        Parameters
        ----------
        frames : iterable of Frame
            Frames in order, each made when it is requested. Do not keep the pictures.
        calibration : Calibration
            The camera as the instrument may know it: never its tilt.

        Returns
        -------
        sequence of Measurement
            One for each frame, in order.

        Raises
        ------
        RecordError
            If the record cannot be used. SwingBench then refuses every frame of the clip, with this reason, and goes on
            with the next one. In other commands it ends the run, as any other error does.
        """


@runtime_checkable
class TakesSensors(Protocol):
    """An instrument that can use sensors beside the camera."""

    def with_sensors(self, sensors: Mapping[str, Path]) -> Instrument:
        """Return an instrument for one record: the next one measured.

        Parameters
        ----------
        sensors : mapping of str to Path
            Folder of each sensor that may be used, by name: ``imu0`` has ``data.csv`` and ``sensor.yaml``, ``plc``
            ``data.csv`` and ``data.toml``.

        Raises
        ------
        RecordError
            If the readings cannot be used. SwingBench, which calls this for each clip, then refuses every frame of the
            clip, with this reason. Any other error ends its run.
        """

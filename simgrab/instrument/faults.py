"""What goes wrong during a live run, found frame by frame."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.controller import CLOCK, Controller, clock_offset, in_words
from simgrab.instrument.forecast import Forecaster
from simgrab.model.geometry import Array

if TYPE_CHECKING:
    from simgrab.instrument.controller_feed import ControllerFeed

SILENT_S = 30.0  # without an angle
STOPPED_S = 10.0  # without a reading of the controller
BEHIND_S = 3.0  # by which frames of a stream are measured too late
LATE_S = 1.0  # least change of the controller's clock that is reported
LENGTHS_S, LEAST_S, BETWEEN_S = 300.0, 60.0, 0.5  # rope lengths that show it: the last, the fewest, and their distance
# Least jump of a direction, and of it over its standard deviation. Without a knock the greatest were 0.52° and 5.6: in
# 20 simulated minutes of the scene work-cycles and 6 of alarm-cycles, seen with 1.3 px of noise.
KNOCK, KNOCK_SD = np.radians(0.7), 6.0
STAYS_S, STAYS = 2.0, 0.8  # how long it must stay, and share of the frames with a grab
EXPOSURE = 2.0  # ratio of the pictures' mean levels
SETTLED_S = 5.0  # over which levels are averaged
BLACK, EVERY = 4.0, 16  # level that is added, so that noise in the dark is no change; pixels between those averaged
_SILENT = {"lost": "picture", "missed": "grab", "unread": "rope", "refused": "angle"}


class Fault(msgspec.Struct, frozen=True):
    """Something that went wrong, or is well again."""

    time_s: float  # of the frame in which it was found
    # `"picture"`, `"grab"`, `"rope"` or `"angle"`: none for half a minute, or again; `"source"`: a stream was
    # connected again, its time stamps jumped, or it is measured late; `"exposure"`; `"camera"`: its tilt changed at
    # once; `"controller"`: its readings stopped, came back, or their clock jumped or is not that of the pictures
    kind: str
    text: str


class Backlog:
    """Watches whether frames of a stream come faster than they are measured."""

    def __init__(self) -> None:
        self._least, self._behind = np.inf, False

    def step(self, clock_s: float, time_s: float) -> str:
        """Return what changed with a frame, given this computer's clock and the frame's time; mostly empty."""
        self._least = min(self._least, clock_s - time_s)
        late = clock_s - time_s - self._least
        if BEHIND_S / 2 < late < BEHIND_S or (late >= BEHIND_S) == self._behind:
            return ""
        self._behind = not self._behind
        if self._behind:
            return f"frames are measured {late:.0f} s late: this computer is too slow, or they came late"
        return "frames are measured in time again"


class FaultWatch:
    """Finds faults; `found` returns those since it was called last.

    Attributes
    ----------
    since : float
        When the direction OA jumped last, s.
    unlike : bool
        Whether the controller's rope length does not follow the display's.
    """

    def __init__(self) -> None:
        self._found: list[tuple[str, str]] = []
        self._usual: list[str] | None = None  # notes of the first picture
        self._last_ok: float | None = None
        self._silent, self._stopped = "", False
        self._begun: float | None = None
        self._time = self._level = self._settled = np.nan
        self._swing = Forecaster()
        self._moved: Forecaster | None = None  # after a jump, as if the camera had been knocked
        self._jump, self._seen = np.zeros(2), list[bool]()
        self._shown = deque[tuple[float, float]](maxlen=int(LENGTHS_S / BETWEEN_S))
        self._lengths = deque[tuple[float, float, float]](maxlen=int(LENGTHS_S / BETWEEN_S))
        self._clock_s, self._compared, self._asked, self.unlike = 0.0, -np.inf, -np.inf, False
        self.since = 0.0

    def found(self, time_s: float) -> tuple[Fault, ...]:
        """Return new faults."""
        faults = tuple(Fault(time_s, kind, text) for kind, text in self._found)
        self._found.clear()
        return faults

    def frame(self, frame: Frame, measured: Measurement) -> None:
        """Watch the source, the exposure, and whether there are angles."""
        now = frame.time_s
        assert now is not None
        if frame.picture is not None:
            notes = frame.note.split("; ") if frame.note else []
            self._usual = notes if self._usual is None else self._usual
            self._found += [("source", note) for note in notes if note not in self._usual]
            self._expose(now, float(frame.picture[::EVERY, ::EVERY].mean()) + BLACK)
        if measured.status == "ok" or self._last_ok is None:
            if self._silent:
                self._found.append((self._silent, f"angles again after {now - (self._last_ok or 0.0):.0f} s"))
            self._silent, self._last_ok = "", now
        elif not self._silent and now - self._last_ok > SILENT_S:
            self._silent = _SILENT[measured.status]
            self._found.append((self._silent, f"no angle for {now - self._last_ok:.0f} s: {measured.reason}"))

    def _expose(self, now: float, level: float) -> None:
        weight = 1.0 if np.isnan(self._time) else -np.expm1((self._time - now) / SETTLED_S)
        self._level = level if np.isnan(self._level) else self._level + weight * (level - self._level)
        self._time = now
        self._settled = self._level if np.isnan(self._settled) else self._settled
        if not 1 / EXPOSURE < self._level / self._settled < EXPOSURE:
            brighter = "brighter" if self._level > self._settled else "darker"
            self._found.append(("exposure", f"pictures are {brighter}: mean level {self._level - BLACK:.0f}, "
                                            f"before {self._settled - BLACK:.0f}"))  # fmt: skip
            self._settled = self._level

    def controller(self, now: float, last: Controller | None, feed: ControllerFeed) -> None:
        """Watch the controller's file that is followed, given its last readings."""
        self._begun = now if self._begun is None else self._begun
        age_s = now - (self._begun if last is None else max(self._begun, float(last.time[-1])))
        if feed.news:
            self._found.append(("controller", feed.news))
            self._lengths.clear()
        if (age_s > STOPPED_S) != self._stopped:
            self._stopped = not self._stopped
            why = f": {feed.problem}" if feed.problem else ""
            stopped = f"no reading for {STOPPED_S:.0f} s; only a display gives the rope's length now{why}"
            self._found.append(("controller", stopped if self._stopped else "readings again"))

    def clock(self, now: float, controller: Controller, display: float) -> None:
        """Watch whether the controller's rope length follows the display's, m and NaN where there is none, in time."""
        if controller.rope is None or now < self._asked + BETWEEN_S:
            return
        self._asked = now
        self._shown.append((now, display))
        read = replace(controller, hold_s=0.0)
        while self._shown and self._shown[0][0] <= controller.time[-1]:  # the age of a reading is no late clock
            at, shown_m = self._shown.popleft()
            self._lengths.append((at, float(read.rope_at(np.array([at]))[0]), shown_m))
        if not self._lengths or now < max(self._lengths[0][0] + LEAST_S, self._compared + STOPPED_S):
            return
        self._compared = now
        time, own, shown = np.array(self._lengths).T
        try:
            alone = replace(read, time=time, slew=None, radius=None, rope=own, wind=None)
            found = clock_offset(alone, time, shown)
        except RecordError as problem:
            self._lengths.clear()
            if not self.unlike:
                self._found.append(("controller", str(problem)))
            self.unlike = True
            return
        self.unlike = False
        low, high = found.interval_s
        if abs(found.offset_s - self._clock_s) > LATE_S and (low > self._clock_s or high < self._clock_s):
            self._clock_s = found.offset_s
            self._found.append(("controller", f"{CLOCK}{in_words(found.offset_s, (low, high), found.source, None)}"))

    def shift(self, by: Array) -> None:
        """Move the directions by (1, 2), rad, because the tilt was estimated again."""
        for one in filter(None, (self._swing, self._moved)):
            one.shift(by)

    def knock(self, now: float, swing: Array, sd: Array, rope: Array) -> bool:
        """Whether the camera was knocked: the direction OA jumped within a frame, and has not jumped back.

        Parameters
        ----------
        swing : ndarray, shape (1, 2)
        sd, rope : ndarray, shape (1,)
            As `Forecaster.step` takes them.
        """
        frame = now, swing, sd, rope
        before = copy.copy(self._swing)
        self._swing.step(*frame)
        if self._moved is None:
            jump = self._swing.error[0]
            if np.hypot(*jump) >= max(KNOCK, KNOCK_SD * float(self._swing.error_sd[0])):
                self._moved, self.since, self._jump, self._seen = before, now, jump, []
                before.shift(jump[None])
                before.step(*frame)
            return False
        moved, earlier = self._moved, copy.copy(self._moved)
        moved.step(*frame)
        self._seen.append(bool(np.isfinite(swing).all()))
        size = float(np.hypot(*self._jump))
        if np.hypot(*(moved.error[0] + self._jump)) < KNOCK / 2 + size / 10:  # as if nothing had been between
            earlier.shift(-self._jump[None])
            earlier.step(*frame)
            self._moved, self._swing = None, earlier
        elif np.hypot(*moved.error[0]) > KNOCK:
            self._moved = None
        elif now - self.since >= STAYS_S:
            self._moved = None
            if np.mean(self._seen) >= STAYS:
                self._swing = Forecaster()
                text = f"the camera's tilt changed by {np.degrees(size):.1f}° at {self.since:.0f} s"
                self._found.append(("camera", text))
                return True
        return False

"""The controller's data as a logger appends them to CSV files, for a live run."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import msgspec
import pyarrow as pa

from simgrab.errors import RecordError
from simgrab.instrument.controller import ClockOffset, Controller
from simgrab.instrument.controller_file import describe, read_controller
from simgrab.instrument.estimate.tables import parsed_csv, separator

KEPT_S = 10.0  # of readings
LEAST_ROWS = 20
MOST_BYTES = 1 << 20  # read at once: of more, the newest
HEADER_BYTES = 1 << 16
DELAYS = 300  # of rows and frames after their stamps, of which the least relate the clocks
CLOCK_S = 5.0  # by which rows are early only if their clock jumped


class ControllerFeed:
    """Follows the controller's data.

    Stamps of rows and times of frames are related by this computer's clock at their arrival, so that only their
    differences count. Rows before the first `poll` are not read.

    Parameters
    ----------
    path : path
        As `read_controller` takes it; CSV.

    Attributes
    ----------
    states_rope, states_radius, states_motion : bool
        Whether it holds rope lengths; radius or luff; and these and slew as often as anything else.
    problem : str
        Why no readings could be made of the newest rows; empty if they could.
    news : str
        What happened to the controller's clock at the last `poll`; mostly empty.

    Raises
    ------
    RecordError
        If there is no description, or a file is parquet.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, facts = describe(path)
        if facts.quantities.keys() <= {"wind", "load"}:
            raise RecordError(f"{path}: a live run does not read the wind; state it by --wind-m-s")
        self._facts = msgspec.structs.replace(facts, wind=None, load=None)
        self.states_rope, self.states_radius = facts.rope is not None, bool(facts.radius or facts.luff)
        jib = [one for one in (facts.slew, facts.radius or facts.luff) if one is not None]
        followed = list(self._facts.quantities.values())
        rate_hz = max(one.rate_hz for one in followed)
        self.states_motion = len(jib) == 2 and min(one.rate_hz for one in jib) > rate_hz / 2
        self.problem = self.news = ""
        self._controller: Controller | None = None
        self._delays, self._late = deque[float](maxlen=DELAYS), deque[float](maxlen=DELAYS)
        self._lag, self._newest = followed[0].lag_s, -math.inf
        self._tails: dict[Path, _Tail] = {}
        for one in followed:
            file = self._facts.file_of(one, self._path)
            if file.suffix.lower() == ".parquet":
                raise RecordError(f"{file}: parquet cannot be followed while it grows; name a CSV file")
            rows = max(math.ceil(KEPT_S * one.rate_hz), LEAST_ROWS)
            earlier = self._tails.get(file)
            self._tails[file] = _Tail(file, max(rows, earlier.most if earlier else 0))

    def poll(self, now: float, clock: float | None = None) -> Controller | None:
        """Read new rows; return the last seconds of readings on the clock of the frames, None before there are any.

        Parameters
        ----------
        now : float
            Time of the frame, s.
        clock : float, optional
            This computer's clock, s.
        """
        clock = time.monotonic() if clock is None else clock
        self.news = ""
        self._late.append(clock - now)
        try:
            if not sum(tail.read() for tail in self._tails.values()):
                return self._controller
            found = read_controller(self._path, self._facts, self._table)
        except RecordError as problem:
            self.problem = str(problem)
            return self._controller
        self.problem = ""
        before, self._newest = self._newest, float(found.time[-1])
        delay = clock - self._newest - self._lag
        late_s = delay - min(self._delays, default=delay)
        if late_s < -CLOCK_S or (late_s > CLOCK_S and self._newest <= before):  # or rows have earlier stamps
            self.news = "its clock jumped; it is related to that of the pictures again"
            self._delays.clear()
            for tail in self._tails.values():
                tail.forget()
            return self._controller
        self._delays.append(delay)
        offset_s = min(self._delays) - min(self._late)
        offset = ClockOffset(offset_s, self._facts.time.clock_sd_s, "the rows' arrival")
        self._controller = replace(found.shifted(offset), hold_s=self._facts.longest_gap_s / 2, motion_late_s=0.0)
        return self._controller

    def _table(self, path: Path) -> pa.Table:
        return parsed_csv(self._tails[path].content, path, self._facts.time.column)


class _Tail:
    """The header and the last lines of a file that grows."""

    def __init__(self, path: Path, most: int) -> None:
        self.most, self._path = most, path
        self._header = b""
        self._position: int | None = None
        self._lines, self._new = deque[bytes](maxlen=most), list[bytes]()

    @property
    def content(self) -> bytes:
        """A CSV file of them."""
        return self._header + b"".join(self._lines)

    def read(self) -> bool:
        """Read complete new lines; whether there are any. A file that became shorter is read from its beginning."""
        try:
            with self._path.open("rb") as file:
                end = file.seek(0, os.SEEK_END)
                if self._position is not None and end < self._position:
                    self._header, self._position = b"", 0
                if not self._header:
                    file.seek(0)
                    first = file.readline(HEADER_BYTES)
                    self._header = first if first.endswith(b"\n") else b""
                    parsed_csv(self._header or b"-", self._path, "")  # refuses other separators
                    if self._header:
                        self._position = end if self._position is None else len(first)
                if not self._header or self._position is None:
                    return False
                begin = file.seek(max(self._position, end - MOST_BYTES))
                data = file.read(end - begin)
        except OSError:
            return False
        whole = data[: data.rfind(b"\n") + 1]
        self._position = begin + len(whole)
        mark = separator(self._header).encode()
        lines, cells = whole.splitlines(keepends=True), self._header.count(mark)
        self._new = [line for line in lines if line.count(mark) == cells]  # one of which a part is missing has fewer
        if lines and not self._new:
            raise RecordError(f"{self._path}: new rows have other numbers of cells than the header")
        self._lines.extend(self._new)
        return bool(self._new)

    def forget(self) -> None:
        """Keep what was read last alone."""
        self._lines = deque(self._new, maxlen=self.most)

"""The display's text in one picture: lengths that lag the crane's, sometimes torn between two values."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from simgrab.model.layouts import Layout
from simgrab.model.scenario import Display

_WEEKDAYS = "一二三四五六日"  # from Monday


@dataclass(frozen=True)
class Shown:
    """The text in one picture, as it can be read there."""

    clock_text: str  # date, weekday and clock
    rope_text: str  # both numbers, above the row where they tore
    rope_text_below: str  # below that row; the same where nothing tore
    torn_row_px: int | None  # first row that shows `rope_text_below`; None where nothing tore


def shown(display: Display, layout: Layout, time_s: float, lengths_at: Callable[[float], tuple[float, float]]) -> Shown:
    """Compute the display's text in the picture whose readout begins at a time.

    The controller refreshes both numbers at the instants k / refresh_hz with the lengths of lag_s before, and holds
    them in between. A refresh at u, while the picture is read out from top to bottom, shows from row
    ⌊(u − time) / readout_s · height⌋ on. That tears the picture only where it can be seen: among rows and digits that
    change. The clock is the camera's own; it neither lags nor tears.

    Parameters
    ----------
    layout : Layout
        Fitted to the picture.
    time_s : float
        Beginning of the readout, 0 or more.
    lengths_at : callable
        Takes a time, s, in [0, time_s + readout_s] and returns |OA| and the closing rope's length from the same
        point, m, both before ``constant_m`` is taken off. Frames that know no time pass a constant, and so neither
        lag nor tear.
    """

    def text_of(refresh: int) -> str:
        hoist, closing = lengths_at(max(0.0, refresh / display.refresh_hz - display.lag_s))
        return layout.text(hoist - display.constant_m, closing - display.constant_m)

    clock = clock_text(display.started, time_s)
    last = math.floor(time_s * display.refresh_hz)
    above = text_of(last)
    into = (last + 1) / display.refresh_hz - time_s
    if into >= display.readout_s:
        return Shown(clock, above, above, None)
    below = text_of(last + 1)
    row = max(0, math.floor(into / display.readout_s * layout.height_px))
    digits = (filter(str.isdigit, text) for text in (above, below))
    changed = [cell for cell, a, b in zip(layout.cells, *digits, strict=True) if a != b]
    if all(y0 >= row for _, y0, _, _ in changed):
        return Shown(clock, below, below, None)
    if all(y1 <= row for _, _, _, y1 in changed):
        return Shown(clock, above, above, None)
    return Shown(clock, above, below, row)


def clock_text(started: datetime, time_s: float) -> str:
    """Write a moment as the display does, truncated to whole seconds.

    Parameters
    ----------
    started : datetime
        Reading of the clock at time 0.
    time_s : float
        Seconds since then.

    Examples
    --------
    >>> clock_text(datetime(2022, 1, 26, 14, 5, 37), 0.99)
    '2022年01月26日 星期三 14:05:37'
    """
    now = started + timedelta(seconds=time_s)
    date = f"{now.year:04d}年{now.month:02d}月{now.day:02d}日"  # %Y does not fill up to four digits everywhere
    return f"{date} 星期{_WEEKDAYS[now.weekday()]} {now:%H:%M:%S}"

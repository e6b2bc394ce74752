"""The display's date, weekday and clock."""

from __future__ import annotations

from datetime import datetime, timedelta

_WEEKDAYS = "一二三四五六日"  # from Monday


def clock_text(started: datetime, time_s: float) -> str:
    """Write a moment as the display does, cut off to the second that has begun.

    Parameters
    ----------
    started : datetime
        What the clock shows at time 0.
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

"""Errors of angles and alarms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.alarm import DANGER, RAISED_AT, Event, danger, events
from simgrab.instrument.contract import Measurement
from simgrab.judge.evaluate.detection import ROPE_BINS_M
from simgrab.model.geometry import Array

LARGE = math.radians(8)
HARDLY_SWINGS_DEG = 0.1  # standard deviation of the true swing, below which errors of angles say little
# An event must be reported whose swing exceeds the first, and none where it stays below the second.
SURELY, HARDLY = math.radians(10.5), math.radians(9.5)
_SLACK_S = 1.0  # by which an alarm may begin before or end after the event that it is of


def errors(estimated: Array, true: Array) -> dict[str, Any]:
    """Errors, in degrees, of angles (n,), rad, for frames in which both are known.

    Returns
    -------
    dict
        ``frames``; ``bias_deg``, ``rmse_deg``, ``p95_deg`` and ``max_deg`` of the absolute error; None without frames.
    """
    off = np.rad2deg(estimated - true)
    off = off[np.isfinite(off)]
    names = ("bias_deg", "rmse_deg", "p95_deg", "max_deg")
    if not len(off):
        return {"frames": 0} | dict.fromkeys(names)
    size = np.abs(off)
    values = (off.mean(), np.sqrt(np.mean(off**2)), np.quantile(size, 0.95), size.max())
    return {"frames": len(off)} | {name: float(value) for name, value in zip(names, values, strict=True)}


def angles(estimated: Array, true: Array, rope: Array, weather: Sequence[str]) -> dict[str, Any]:
    """Errors of all frames, of large swings, by rope length and by weather."""

    def among(some: NDArray[np.bool_]) -> dict[str, Any]:
        return errors(estimated[some], true[some])

    names = np.array(weather)
    return {
        "overall": errors(estimated, true),
        "above_8_deg": among(true > LARGE),
        "by_rope": {name: among((rope >= low) & (rope < high)) for name, (low, high) in ROPE_BINS_M.items()},
        "by_weather": {str(name): among(names == name) for name in dict.fromkeys(weather) if name},
    }


def coverage(ends: Array, true: Array) -> dict[str, Any]:
    """Share of true angles (n,), rad, within their intervals (n, 2), and these intervals' mean width in degrees."""
    known = np.isfinite(ends).all(axis=-1) & np.isfinite(true)
    if not known.any():
        return {"frames": 0, "share": None, "width_deg": None}
    low, high = ends[known].T
    inside = (low <= true[known]) & (true[known] <= high)
    return {
        "frames": int(known.sum()),
        "share": float(inside.mean()),
        "width_deg": float(np.rad2deg(high - low).mean()),
    }


def true_events(times: Array, true: Array) -> tuple[Event, ...]:
    """Events of the true swing, by the same rule: from the first frame beyond 10°."""
    return events(times, by_angles(true))


def by_angles(alpha: Array) -> list[Measurement]:
    """Measurements of angles (n,), rad, alone."""
    return [
        Measurement(status="ok", alpha=a) if math.isfinite(a) else Measurement(status="lost", reason="not known")
        for a in alpha.tolist()
    ]


def alarms(times: Array, measurements: Sequence[Measurement], raised: Sequence[Event], true: Array) -> dict[str, Any]:
    """Compare alarms with the events of the true swing.

    Returns
    -------
    dict
        ``events`` of the true swing, the number of ``sure`` ones, and how many of these were ``missed``; ``reported``
        alarms, and how many of them were ``false``; the number of reported events with an alarm ``already_on``, raised
        more than a second before, and for the others the ``delays`` in frames, negative if the alarm came before, and
        their ``median_delay``; ``precision`` and ``recall`` of single frames beyond 10°, among frames with an angle.
    """
    real = true_events(times, true)
    sure = [e for e in real if e.alpha > SURELY]
    delays, already_on = [], 0
    for event in real:
        reports = [f for f in raised if meet(event, f)]
        if reports and reports[0].onset_s < event.onset_s - _SLACK_S:
            already_on += 1
        elif reports:
            delays.append(reports[0].first - event.first)
    false = [f for f in raised if not swings_in(times, true, f)]
    said = np.array([danger(m) >= RAISED_AT for m in measurements], bool)
    given = np.array([m.alpha is not None for m in measurements], bool) & np.isfinite(true)
    said, real_danger = said[given], true[given] > DANGER
    both = int((said & real_danger).sum())
    return {
        "events": len(real),
        "sure": len(sure),
        "missed": sum(not any(meet(e, f) for f in raised) for e in sure),
        "reported": len(raised),
        "false": len(false),
        "delays": delays,
        "already_on": already_on,
        "median_delay": float(np.median(delays)) if delays else None,
        "precision": both / int(said.sum()) if said.any() else None,
        "recall": both / int(real_danger.sum()) if real_danger.any() else None,
    }


def meet(event: Event, alarm: Event) -> bool:
    """Whether an alarm belongs to an event."""
    return alarm.onset_s <= event.end_s + _SLACK_S and alarm.end_s >= event.onset_s - _SLACK_S


def swings_in(times: Array, true: Array, alarm: Event) -> bool:
    """Whether the true swing reaches a level that may count as danger while an alarm is on."""
    during = (times >= alarm.onset_s - _SLACK_S) & (times <= alarm.end_s + _SLACK_S)
    return bool((true[during] >= HARDLY).any())

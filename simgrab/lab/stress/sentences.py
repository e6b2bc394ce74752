"""A sentence for each figure, made of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from simgrab.instrument.estimate import ZeroTilt
from simgrab.lab.stress.score import MARGIN_DEG
from simgrab.lab.stress.study import axis_of
from simgrab.lab.stress.summary import Figure, Point, Summary

ALARM_DEG = 10.0


def at(summary: Summary, point: Point) -> str:
    """Name a point: its axes with values and units."""
    pairs = zip(summary.study.axes, point, strict=True)
    texts = (
        f"{s.axis} = {v}" if isinstance(v, str) else f"{s.axis} = {v:g} {axis_of(s.axis).unit}".rstrip()
        for s, v in pairs
    )
    return ", ".join(texts)


def rivals(summary: Summary) -> list[str]:
    """Estimators worth a word: all, but for the one that corrects nothing."""
    return [name for name in summary.study.estimators if name != ZeroTilt.name] or list(summary.study.estimators)


def extreme(
    summary: Summary, points: Sequence[Point], column: str, key: Callable[[Figure], float]
) -> tuple[Figure, str, Point] | None:
    """Find the estimator and the point with the largest ``key`` of a column."""
    found = [
        (key(figure), name, point)
        for name in rivals(summary)
        for point in points
        if (figure := summary.at(point, name, column)).count
    ]
    if not found:
        return None
    _, name, point = max(found, key=lambda f: f[0])
    return summary.at(point, name, column), name, point


def _mildest(
    summary: Summary, points: Sequence[Point], column: str, key: Callable[[Figure], float]
) -> tuple[str, float]:
    """Name the estimator whose worst point is best, and how bad that is. One that refuses a tenth does not count."""
    worst = {}
    for name in rivals(summary):
        figures = [f for p in points if (f := summary.at(p, name, column)).count]
        refused = max((summary.at(p, name, "refused").mean for p in points), default=0.0)
        if figures and not refused > 0.1:
            worst[name] = max(map(key, figures))
    if not worst:
        return "", np.nan
    name = min(worst, key=lambda n: worst[n])
    return name, worst[name]


def bias(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of the bias of β̂."""
    found = extreme(summary, points, "beta_error_deg", lambda f: abs(f.mean))
    if found is None:
        return "No record was solved."
    figure, name, point = found
    text = f"β̂ is off most for {name}: {figure.mean:+.3f} ± {figure.mean_se:.3f}° at {at(summary, point)}"
    best, size = _mildest(summary, points, "beta_error_deg", lambda f: abs(f.mean))
    return text + (f"; least for {best}, by {size:.3f}° at most." if best and best != name else ".")


def spread(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of the root mean square error of β̂."""
    found = extreme(summary, points, "beta_error_deg", lambda f: f.rms)
    if found is None:
        return "No record was solved."
    figure, name, point = found
    text = f"The RMSE of β̂ is largest for {name}: {figure.rms:.3f} ± {figure.rms_se:.3f}° at {at(summary, point)}"
    best, size = _mildest(summary, points, "beta_error_deg", lambda f: f.rms)
    return text + (f"; {best} stays within {size:.3f}°." if best and best != name else ".")


def coverage(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of the 95 % intervals."""
    parts = []
    for column, symbol in (("cover_beta", "β"), ("cover_sigma", "σ")):
        found = extreme(summary, points, column, lambda f: -f.mean)
        if found is not None:
            figure, name, point = found
            share = f"{100 * figure.mean:.1f} ± {100 * figure.mean_se:.1f} %"
            parts.append(f"of {symbol} covers it in {share} ({name}, {at(summary, point)})")
    return f"At worst the 95 % interval {' and that '.join(parts)}." if parts else "There are no intervals."


def failures(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of refusals."""
    found = extreme(summary, points, "refused", lambda f: f.mean)
    if found is None or found[0].mean == 0:
        return "No record is refused."
    figure, name, point = found
    return (
        f"{name} refuses {100 * figure.mean:.1f} ± {100 * figure.mean_se:.1f} % of the records at {at(summary, point)}."
    )


def alarm_error(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of α̂ at a true 10°."""
    found = extreme(summary, points, "alpha10_most_deg", lambda f: f.mean)
    if found is None:
        return "No record was solved."
    figure, name, point = found
    text = (
        f"At a true {ALARM_DEG:g}° α̂ errs by {figure.mean:.2f} ± {figure.mean_se:.2f}° in the worst direction "
        f"({name}, {at(summary, point)})"
    )
    best, size = _mildest(summary, points, "alpha10_most_deg", lambda f: f.mean)
    return text + (f"; {best} stays within {size:.2f}°." if best and best != name else ".")


def alarms(summary: Summary, points: Sequence[Point]) -> str:
    """Speak of missed and false alarms."""
    over, under = ALARM_DEG + MARGIN_DEG, ALARM_DEG - MARGIN_DEG
    missed = extreme(summary, points, "miss", lambda f: f.mean)
    false = extreme(summary, points, "false_alarm", lambda f: f.mean)
    if missed is None or false is None:
        return "No record was solved."
    if missed[0].mean == 0 and false[0].mean == 0:
        return f"No swing of {over:g}° is missed and none of {under:g}° sets off the alarm."

    def largest(found: tuple[Figure, str, Point]) -> str:
        figure, name, point = found
        return f"up to {100 * figure.mean:.1f} ± {100 * figure.mean_se:.1f} % ({name}, {at(summary, point)})"

    texts = []
    for found, what in (
        (missed, f"swings of {over:g}° are missed"),
        (false, f"swings of {under:g}° set off the alarm"),
    ):
        texts.append(f"{largest(found)} of the {what}" if found[0].mean > 0 else f"none of the {what}")
    text = "; ".join(texts) + "."
    return text[0].upper() + text[1:]

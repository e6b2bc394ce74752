"""The port's protocol: a swing beyond 10° is danger, on a scale that ends at 20°."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated

import msgspec
import numpy as np
from scipy import special

from simgrab.errors import RunError
from simgrab.instrument.contract import Measurement
from simgrab.io.strict import Checked
from simgrab.model.geometry import Array

Meta = msgspec.Meta

DANGER = math.radians(10)
SCALE = math.radians(20)
_NORMAL = 1.959964  # two-sided, 95 %


class Rule(Checked, frozen=True):
    """When an alarm is raised, and when it ends.

    Attributes
    ----------
    raised_at : float
        Least probability that α exceeds 10°. At 0.5 the alarm depends on α̂ alone. A growing swing on 10 m of rope
        gains 0.7° from one frame to the next (9 frames/s), so a higher probability delays alarms little, and it
        suppresses alarms from blurred frames.
    frames : int
        Number of consecutive frames with an α that must reach this probability.
    released_at : float
        Hysteresis, rad: α must stay below this value for the alarm to end.
    quiet_s : float
        Time, s, that α must stay below it: half a period of the longest rope, since a swing passes through 0 between
        its turning points.
    """

    error = RunError

    raised_at: Annotated[float, Meta(ge=0, le=1)] = 0.7
    frames: Annotated[int, Meta(ge=1, le=10_000)] = 1
    released_at: Annotated[float, Meta(ge=0, le=math.pi)] = math.radians(9)
    quiet_s: Annotated[float, Meta(ge=0, le=3600)] = 6.0


ALARM = Rule()
# Of "will pass 10° within 6 s": fitted to one false warning in an hour of work by `scripts.early_warning`.
WARNING = Rule(raised_at=0.6)


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One alarm. Indices are of the record's frames, angles radians.

    Attributes
    ----------
    first, last, peak : int
        Frame in which the alarm was raised, last frame above the release, and frame of the largest α.
    onset_s, end_s, peak_s : float
        Their times.
    alpha, alpha_low, alpha_high : float
        At the peak, with the ends of its interval where there is one.
    danger : float
        Greatest probability.
    ongoing : bool
        Whether the record ended before the alarm did.
    """

    first: int
    last: int
    peak: int
    onset_s: float
    end_s: float
    peak_s: float
    alpha: float
    alpha_low: float | None
    alpha_high: float | None
    danger: float
    ongoing: bool

    @property
    def duration_s(self) -> float:
        """From onset to end."""
        return self.end_s - self.onset_s


def probability(alpha: Array, low: Array, high: Array) -> Array:
    """Probability that a swing exceeds 10°, shape (n,): Gaussian about α with the deviation of its 95 % interval.

    NaN where α is NaN; without an interval α is taken as exact.
    """
    return np.where(np.isnan(alpha), np.nan, exceeding(alpha, (high - low) / (2 * _NORMAL), DANGER))


def share(alpha: Array, low: Array, high: Array) -> dict[str, float | None]:
    """Share of a record's frames in which the swing exceeds 10°; NaN in frames without an α, which do not count.

    Returns
    -------
    dict
        ``share``: its expectation, the mean of `probability`. ``low`` and ``high``: its interval, the shares of frames
        whose 95 % interval of α lies beyond 10°, and reaches beyond. It holds in 95 % of records if errors of α are
        alike in all frames, and more often if they are not. Of frames without an interval α is taken as exact; None
        where all intervals or angles lack.
    """
    known = np.isfinite(alpha)
    if not known.any():
        return dict.fromkeys(("share", "low", "high"))
    mean = float(np.mean(probability(alpha, low, high)[known]))
    if not np.isfinite(high[known]).any():
        return {"share": mean, "low": None, "high": None}
    surely, perhaps = (float(np.mean(np.where(np.isnan(end), alpha, end)[known] > DANGER)) for end in (low, high))
    return {"share": mean, "low": min(surely, mean), "high": max(perhaps, mean)}


def deviation(alpha: Array, high: Array) -> Array:
    """Find the standard deviation of α from the upper end of its 95 % interval; the lower end is cut off at 0."""
    return (high - alpha) / _NORMAL


def exceeding(alpha: Array, sd: Array, limit: float) -> Array:
    """Probability that Gaussian swings exceed a limit; 0 or 1 where the deviation is not above 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sd > 0, special.ndtr((alpha - limit) / sd), np.where(alpha > limit, 1.0, 0.0))


def danger(m: Measurement) -> float:
    """Probability that a swing exceeds 10°, if a measurement states it; otherwise α is taken as exact."""
    return m.danger if m.danger is not None else float(m.alpha is not None and m.alpha > DANGER)


def warning(m: Measurement) -> float:
    """Probability that α exceeds 10° within seconds, if a measurement states it; otherwise 0."""
    return m.warning if m.warning is not None else 0.0


def events(
    times: Array, measurements: Sequence[Measurement], rule: Rule = ALARM,
    chance: Callable[[Measurement], float] = danger,
) -> tuple[Event, ...]:  # fmt: skip
    """Alarms of a record.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Seconds, increasing.
    measurements : sequence of n Measurement
        Frames without an α neither raise nor end an alarm.
    rule : Rule
    chance : callable
        The probability that raises an alarm: `danger`, or `warning` for `WARNING`.
    """
    found: list[Event] = []
    sure = 0
    since: int | None = None  # frame in which the present alarm was raised
    last = 0
    for i, m in enumerate(measurements):
        if m.alpha is None:
            continue
        sure = sure + 1 if chance(m) >= rule.raised_at else 0
        if since is not None and times[i] - times[last] > rule.quiet_s:
            found.append(_event(times, measurements, since, last, chance, ongoing=False))
            since = None
        if since is None and sure >= rule.frames:
            since = last = i
        elif since is not None and (sure or m.alpha >= rule.released_at):
            last = i
    if since is not None:
        quiet = times[-1] - times[last] > rule.quiet_s
        found.append(_event(times, measurements, since, last, chance, ongoing=not quiet))
    return tuple(found)


def _event(
    times: Array, measurements: Sequence[Measurement], first: int, last: int, chance: Callable[[Measurement], float], *,
    ongoing: bool,
) -> Event:  # fmt: skip
    within = range(first, last + 1)
    peak = max(within, key=lambda i: measurements[i].alpha or 0.0)
    top = measurements[peak]
    assert top.alpha is not None
    return Event(
        first=first, last=last, peak=peak,
        onset_s=float(times[first]), end_s=float(times[last]), peak_s=float(times[peak]),
        alpha=top.alpha, alpha_low=top.alpha_low, alpha_high=top.alpha_high,
        danger=max(chance(measurements[i]) for i in within), ongoing=ongoing,
    )  # fmt: skip

"""The port's protocol: a swing beyond 10° is danger, on a scale that ends at 20°."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
from scipy import special

from simgrab.instrument.contract import Measurement
from simgrab.model.geometry import Array

DANGER = math.radians(10)
SCALE = math.radians(20)
_NORMAL = 1.959964  # two-sided, 95 %


# Least probability that α exceeds 10° at which an alarm is raised. At 0.5 it would depend on α̂ alone. A growing swing
# on 10 m of rope gains 0.7° from one frame to the next (9 frames/s), so a higher probability delays alarms little, and
# it suppresses alarms from blurred frames.
RAISED_AT = 0.7
# Of "will pass 10° within 6 s": fitted to one false warning in an hour of work by `scripts.early_warning`.
WARNED_AT = 0.6
# An alarm ends once α stays below this value for half a period of the longest rope: a swing passes through 0 between
# its turning points.
RELEASED_AT, QUIET_S = math.radians(9), 6.0


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One alarm. Indices are of the record's frames, angles radians."""

    # first, last, peak: frame in which the alarm was raised, last frame above the release, and frame of the largest α
    first: int
    last: int
    peak: int
    # onset_s, end_s, peak_s: their times
    onset_s: float
    end_s: float
    peak_s: float
    # alpha, alpha_low, alpha_high: at the peak, with the ends of its interval where there is one
    alpha: float
    alpha_low: float | None
    alpha_high: float | None
    danger: float  # greatest probability
    ongoing: bool  # whether the record ended before the alarm did

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
    times: Array, measurements: Sequence[Measurement], raised_at: float = RAISED_AT,
    chance: Callable[[Measurement], float] = danger,
) -> tuple[Event, ...]:  # fmt: skip
    """Alarms of a record.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Seconds, increasing.
    measurements : sequence of n Measurement
        Frames without an α neither raise nor end an alarm.
    chance : callable
        The probability that raises an alarm at ``raised_at``: `danger`, or `warning` at `WARNED_AT`.
    """
    found: list[Event] = []
    since: int | None = None  # frame in which the present alarm was raised
    last = 0
    for i, m in enumerate(measurements):
        if m.alpha is None:
            continue
        sure = chance(m) >= raised_at
        if since is not None and times[i] - times[last] > QUIET_S:
            found.append(_event(times, measurements, since, last, chance, ongoing=False))
            since = None
        if since is None and sure:
            since = last = i
        elif since is not None and (sure or m.alpha >= RELEASED_AT):
            last = i
    if since is not None:
        quiet = times[-1] - times[last] > QUIET_S
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

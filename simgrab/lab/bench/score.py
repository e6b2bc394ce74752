"""The scorer: how good entries are, with intervals over clips, and which of them differ.

A change to any figure raises `SCORER`: scores of different versions are not compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from simgrab.errors import BenchError
from simgrab.instrument.alarm import events
from simgrab.judge.evaluate import swings
from simgrab.lab.bench.entry import Answers, Entry, MethodDescription
from simgrab.lab.bench.files import ClipTruth
from simgrab.lab.bench.season import track_order
from simgrab.model.geometry import Array

SCORER = "1"
THRESHOLDS_DEG = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0)
NEAR_DANGER_DEG = (9.5, 10.5)  # true swings at which the error "at 10°" is taken
REPLICATIONS, SEED = 1000, 0  # of the bootstrap over clips
LEVEL, PERMUTATIONS = 0.05, 9999  # of the test by which entries share a rank


@dataclass(frozen=True)
class IntervalEstimate:
    """A figure, with the ends of its 95 % interval over clips; None where nothing was there to count."""

    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, eq=False)
class EntryScore:
    """Figures of one entry.

    Attributes
    ----------
    about : MethodDescription
    frames, clips : int
        That were scored.
    figures : dict of str to IntervalEstimate
        ``average_recall``: the mean over `THRESHOLDS_DEG` and clips of the share of frames whose error is within the
        threshold; a frame without an angle is within none. ``answered``: share of frames with an angle. Of these:
        ``rmse_deg``, ``p95_deg`` of the absolute error, ``at_10_deg``, the mean error at a true swing of 9.5° to
        10.5°, and ``coverage`` and mean ``width_deg`` of the 95 % intervals. ``alarms_due``: swings beyond 10.5°;
        ``alarms_missed``: how many of these; ``alarms_false``, and the median ``alarm_delay_frames``, by the rule of
        `simgrab.instrument.alarm`. ``ms_per_frame``: median of what the entry states.
    sanity : bool
        Whether it is computed from the truth, to test the scorer.
    recalls : ndarray, shape (clips,)
        Average recall of each clip.
    rank : int
        Within the track, by average recall. An entry shares the rank of the best one from which it does not differ
        (paired permutation test over clips, two-sided, 5 %).
    """

    about: MethodDescription
    frames: int
    clips: int
    figures: dict[str, IntervalEstimate]
    sanity: bool
    recalls: Array = field(repr=False)
    rank: int = 0


def score(entries: Sequence[Entry], targets: Sequence[ClipTruth]) -> tuple[EntryScore, ...]:
    """Score entries by track, the best first, and then three that are computed from the truth.

    Raises `BenchError` if no frame shows a grab.
    """
    targets = [target for target in targets if target.counts.any()]
    if not targets:
        raise BenchError("no frame of these clips shows a grab")
    season = entries[0].about.season if entries else "open"
    result = list[EntryScore]()
    for track in sorted({entry.about.track for entry in entries}, key=track_order):
        result += _ranked([_score(entry, targets, sanity=False) for entry in entries if entry.about.track == track])
    return (*result, *(_score(entry, targets, sanity=True) for entry in sanity(targets, season)))


def sanity(targets: Sequence[ClipTruth], season: str) -> tuple[Entry, ...]:
    """Entries of which the scores are known: the truth, the truth of the frame before, and a swing of 0°."""

    def answers(alpha: Array) -> Answers:
        known = np.isfinite(alpha)
        status = tuple(np.where(known, "ok", "missed").tolist())
        return Answers(status, alpha, alpha, alpha, np.zeros(len(alpha)))

    def entry(name: str, of: dict[str, Answers]) -> Entry:
        return Entry(MethodDescription(name, "picture", season), of)

    return (
        entry("truth", {t.clip: answers(t.alpha) for t in targets}),
        entry("last value", {t.clip: answers(np.concatenate([[0.0], t.alpha[:-1]])) for t in targets}),
        entry("constant 0°", {t.clip: answers(np.zeros(len(t.alpha))) for t in targets}),
    )


def recall(answers: Answers, target: ClipTruth) -> float:
    """Average recall over a clip's frames with a grab, of which there is one at least."""
    off = np.rad2deg(np.abs(answers.alpha - target.alpha))[target.counts]
    # Angles are written to a millionth of a degree.
    return float(np.mean([(off <= t + 1e-6).mean() for t in THRESHOLDS_DEG]))  # NaN is within none


def _score(entry: Entry, targets: Sequence[ClipTruth], *, sanity: bool) -> EntryScore:
    pairs = [(entry.clips[target.clip], target) for target in targets]
    # Clips of each replication of the bootstrap, (`REPLICATIONS`, clips): the same for all entries.
    samples = np.random.default_rng(SEED).integers(len(targets), size=(REPLICATIONS, len(targets)))
    recalls = np.array([recall(*pair) for pair in pairs])

    def over(statistic: Callable[[Array], Any], of: Callable[[Answers, ClipTruth], Array]) -> IntervalEstimate:
        """Figure of all clips' values together, with its interval over clips."""
        values = [of(*pair) for pair in pairs]
        if not sum(map(len, values)):
            return IntervalEstimate(None)
        resampled = (np.concatenate([values[i] for i in some]) for some in samples.tolist())
        return _figure(statistic(np.concatenate(values)), [statistic(each) for each in resampled if len(each)])

    seconds = np.concatenate([answers.seconds for answers, _ in pairs])
    figures = {
        "average_recall": _figure(recalls.mean(), recalls[samples].mean(axis=1)),
        "answered": over(np.mean, lambda a, t: a.ok[t.counts].astype(float)),
        "rmse_deg": over(lambda off: np.sqrt(np.mean(off**2)), _errors),
        "p95_deg": over(lambda off: np.quantile(np.abs(off), 0.95), _errors),
        "at_10_deg": over(np.mean, lambda a, t: _errors(a, t, *NEAR_DANGER_DEG)),
        "coverage": over(np.mean, _covers),
        "width_deg": over(np.mean, lambda a, t: np.rad2deg(a.high - a.low)[np.isfinite(a.low) & t.counts]),
        **_alarms(pairs),
        "ms_per_frame": IntervalEstimate(float(np.median(seconds)) * 1e3 if len(seconds) else None),
    }
    frames = sum(int(target.counts.sum()) for target in targets)
    return EntryScore(entry.about, frames, len(targets), figures, sanity, recalls)


def _errors(answers: Answers, target: ClipTruth, low_deg: float = 0.0, high_deg: float = np.inf) -> Array:
    """Errors of the frames with an angle whose true swing lies between two angles, degrees."""
    true = np.rad2deg(target.alpha)  # NaN without a grab
    return np.rad2deg(answers.alpha - target.alpha)[answers.ok & (true >= low_deg) & (true <= high_deg)]


def _covers(answers: Answers, target: ClipTruth) -> Array:
    """Whether intervals hold the truth, of the frames that have one."""
    known = np.isfinite(answers.low) & target.counts
    slack = np.deg2rad(1e-6)  # angles are written to a millionth of a degree
    inside = (answers.low - slack <= target.alpha) & (target.alpha <= answers.high + slack)
    return inside[known].astype(float)


def _alarms(pairs: Sequence[tuple[Answers, ClipTruth]]) -> dict[str, IntervalEstimate]:
    due = missed = false = 0
    delays = list[int]()
    for answers, target in pairs:
        measured = answers.measurements
        found = swings.alarms(target.times, measured, events(target.times, measured), target.alpha)
        due, missed, false = due + found["sure"], missed + found["missed"], false + found["false"]
        delays += found["delays"]
    return {
        "alarms_due": IntervalEstimate(float(due)),
        "alarms_missed": IntervalEstimate(float(missed)),
        "alarms_false": IntervalEstimate(float(false)),
        "alarm_delay_frames": IntervalEstimate(float(np.median(delays)) if delays else None),
    }


def _figure(value: float, resampled: Sequence[float] | Array) -> IntervalEstimate:
    low, high = np.quantile(resampled, (0.025, 0.975))
    return IntervalEstimate(float(value), float(low), float(high))


def _ranked(scores: Sequence[EntryScore]) -> list[EntryScore]:
    """Order scores of one track, and give them ranks."""
    result = list[EntryScore]()
    best: EntryScore | None = None  # of those that share a rank
    for place, one in enumerate(sorted(scores, key=lambda s: -s.recalls.mean()), 1):
        if best is None or _differ(best.recalls - one.recalls):
            best = one = replace(one, rank=place)
        result.append(replace(one, rank=best.rank))
    return result


def _differ(difference: Array) -> bool:
    """Whether the mean of paired differences, shape (clips,), is significantly other than 0."""
    test = stats.permutation_test(
        (difference,), np.mean, permutation_type="samples", n_resamples=PERMUTATIONS, rng=np.random.default_rng(SEED)
    )
    return bool(test.pvalue < LEVEL)

"""Sentences that state why a scene of a check failed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from simgrab.instrument.alarm import events
from simgrab.instrument.contract import Measurement
from simgrab.instrument.run.runs import Run, reasons
from simgrab.judge.check.mistakes import CLEARLY, FEWEST, Mistake, likely, of_centres, of_rope
from simgrab.judge.check.trial import Metrics, Trial, flat
from simgrab.judge.evaluate.budget import by_centres, contributions, of_tilt, with_lengths
from simgrab.judge.evaluate.swings import alarms, angles, by_angles, coverage
from simgrab.judge.evaluate.truths import Truths
from simgrab.model.geometry import Array, swing_of

STILL = 10  # times less than the swing, an angle hardly follows it
FEW_LOST = 0.05  # of the frames, which explain nothing
UNEXPLAINED = "No single mistake was found that explains the errors of the angle."
_LISTED = 4  # frames at most
_OF_ANGLES = "angle.", "interval.", "alarm."
_OF_LOST = *_OF_ANGLES, "frames.", "detection."  # figures that frames without an angle may spoil


class Cause(NamedTuple):
    """What errors consist of, in sentences, and the mistakes of which it may be one, none if it names none."""

    text: str
    mistakes: tuple[str, ...] = ()


def causes(
    trial: Trial, failed: Sequence[str], *, compared: bool = False, steady: bool = False,
    meets: Callable[[Metrics], bool] = lambda _: True,
) -> Iterator[Cause]:  # fmt: skip
    """State what the errors of a scene consist of.

    Parameters
    ----------
    trial : Trial
    failed : sequence of str
        Metrics that failed: sentences on the centre and on the angle are left out unless a metric of theirs did that
        right angles would mend.
    compared : bool
        Whether one of them has a baseline.
    steady : bool
        Whether the centres are as good as the baseline's, so that they are not what became worse.
    meets : callable
        Whether these would pass with other values of some metrics. A mistake is named only if they would without it.
    """
    run, known, true = trial.run, trial.known, trial.known.alpha
    failed = _mendable(failed, true, run, known, meets)
    if not failed:
        return

    def mends(alpha: Array) -> bool:
        """Whether all failed figures of angles, one at least, would pass with others (n,), rad."""
        return meets({what: value for what, value in _metrics(alpha, run, known).items() if what in failed})

    there = [m for m, labelled in zip(run.measurements, known.labelled, strict=True) if labelled]
    lost = reasons(there)
    count = sum(count for *_, count in lost)
    few = 0 if any(what.startswith("frames.") for what in failed) else FEW_LOST * len(there)
    if count > few and any(what.startswith(_OF_LOST) for what in failed):
        listed = "; ".join(f"{status} ({reason}) in {count}" for status, reason, count in lost[:3])
        yield Cause(f"{count} of {len(there)} frames with a grab have no angle: {listed}.")
    late = of_centres(run.pixels, known.centre, run.time)
    if late is not None and any(what.startswith(("detection.", *_OF_ANGLES)) for what in failed):
        yield Cause(f"{late.text}.", late.alternatives)
    elif any(what.startswith("detection.centre") for what in failed):
        yield from _of_pixels(trial)
    read = run.rope_length
    display, shown = trial.dataset.scenario.display, trial.dataset.scenario.display_layout is not None
    ages_s = (display.lag_s, display.lag_s + 1 / display.refresh_hz) if shown else None
    wrong = of_rope(read, known.rope_length, run.time, ages_s=ages_s)
    lengths = [] if wrong is None or wrong.own else list(_of_lengths(wrong, run, known, meets, mends))
    yield from lengths
    if any(what.startswith("reading.length") for what in failed) and np.isfinite(read).any():
        if wrong is not None and wrong.own:
            yield Cause(f"{wrong.text}.")
        elif wrong is None:
            yield Cause("No factor, constant or delay was found that explains the lengths' errors.")
    if not any(what.startswith((*_OF_ANGLES, "frames.")) for what in failed):
        return
    if of_nothing := trial.metrics.get("frames.without_grab"):
        yield _alone(f"{of_nothing:.0f} of {np.isfinite(run.alpha).sum()} angles are of frames without a grab.")
    failed = _mendable(failed, np.where(np.isfinite(run.alpha), true, np.nan), run, known, meets)
    if not any(what.startswith(_OF_ANGLES) for what in failed):
        return
    if not_seen := _without_centres(run, true):
        yield _alone(not_seen)
        nothing = Measurement(status="missed", reason="no centre")
        kept = (m if np.isfinite(at).all() else nothing for m, at in zip(run.measurements, run.pixels, strict=True))
        run = replace(run, measurements=tuple(kept))
        if mends(run.alpha):
            return
    both = np.isfinite(run.alpha) & np.isfinite(true)
    if both.any():
        measured, swing = np.rad2deg(run.alpha[both]), np.rad2deg(true[both])
        moves = measured.std() >= swing.std() / STILL
        given = bool(np.isfinite(read).any()) and (wrong is None or wrong.own)
        mistake = None
        if moves and not lengths:
            seen, grab = (true, None) if late else _by_inputs(run, known)
            mistake = likely(run.alpha, seen, known.rows, run.time, grab=grab, rope_known=given)
            mistake = mistake and mistake._replace(left=mistake.left + seen - true)
        if mistake and not mends(true + mistake.left):
            mistake = None
        rmse = _rms(measured - swing)
        if mistake:
            rest = np.rad2deg(_rms(mistake.left))
            text = f"{mistake.text}. Otherwise the RMSE would be {rest:.2f}° instead of {rmse:.2f}°."
            yield Cause(text, mistake.alternatives)
            if not mistake.of_tilt:
                return
        found = [] if mistake or late else list(_of_angles(measured, swing))
        if not late:
            found += _of_stages(trial, run, rmse, float(swing.std()), compared=compared, steady=steady)
        yield from map(_alone, found)
        if not (found or mistake or lengths or late):
            yield Cause(UNEXPLAINED)


def _alone(text: str) -> Cause:
    """Make the cause whose one mistake its first sentence states."""
    return Cause(text, (text.partition(". ")[0].removesuffix("."),))


def _without_centres(run: Run, true: Array) -> str:
    """State that most of the error is of angles without a centre beside them, as of one that is kept; else empty."""
    off, seen = run.alpha - true, np.isfinite(run.pixels).all(axis=1)
    known = np.isfinite(off)
    without, rmse, rest = known & ~seen, _rms(off), _rms(off[seen])
    if not without.any() or (known & seen).sum() < FEWEST or rest >= rmse / 2:
        return ""
    same = int((np.diff(run.alpha, prepend=np.nan)[without] == 0).sum())
    return (
        f"{without.sum()} angles have no centre beside them; {same} of these repeat the frame before. Without "
        f"the {without.sum()} the RMSE would be {np.rad2deg(rest):.2f}° instead of {np.rad2deg(rmse):.2f}°."
    )


def _of_pixels(trial: Trial) -> Iterator[Cause]:
    """State the mean error of the centres, and the largest ones."""
    offset = [trial.metrics.get(f"detection.centre.{axis}_mean_px") for axis in "uv"]
    if offset[0] is not None and offset[1] is not None:
        right, down = "right of" if offset[0] > 0 else "left of", "below" if offset[1] > 0 else "above"
        yield _alone(
            f"On average the measured centre lies {abs(offset[0]):.1f} px {right} and {abs(offset[1]):.1f} px {down} "
            "the true one."
        )
    if trial.centres:
        worst = sorted(trial.centres, key=lambda centre: -centre.off_px)[:_LISTED]
        yield Cause(
            f"Largest errors of the centre: {', '.join(f'{c.off_px:.1f} px in frame {c.frame}' for c in worst)}."
        )


def _by_inputs(run: Run, known: Truths) -> tuple[Array, Array | None]:
    """Swings (n,), rad, and places of the grab (n, 3) that follow from a run's centres and lengths.

    They are the true ones in frames without both, and everywhere if these explain nothing.
    """
    places = by_centres(run, known, "read")
    swing, true = swing_of(places)[0], np.full(places.shape, np.nan)
    there = [row is not None for row in known.rows]
    true[there] = np.reshape([row.jib_from_grab for row in known.rows if row is not None], (-1, 3, 4))[..., 3]
    some = np.isfinite(swing) & np.isfinite(run.alpha)
    if not some.any() or _rms((run.alpha - swing)[some]) >= _rms((run.alpha - known.alpha)[some]):
        return known.alpha, None
    seen = np.isfinite(swing)
    return np.where(seen, swing, known.alpha), np.where(seen[:, None], places, true)


def _of_lengths(
    mistake: Mistake, run: Run, known: Truths, meets: Callable[[Metrics], bool], mends: Callable[[Array], bool]
) -> Iterator[Cause]:
    """Name a factor or constant of rope lengths without which their figures, or those of the angle, would pass."""
    off = np.abs(mistake.left[np.isfinite(mistake.left)])
    figures = {"median_m": np.median(off), "p95_m": np.quantile(off, 0.95), "max_m": off.max()}
    rests = meets({f"reading.length.{name}": float(value) for name, value in figures.items()})
    if rests or [mends(with_lengths(run, known, rope)) for rope in ("read", "true")] == [False, True]:
        text = f"{mistake.text}. Otherwise their error would be {np.rint(100 * mistake.rms):.0f} cm."
        yield Cause(text, mistake.alternatives)


def _mendable(
    failed: Sequence[str], right: Array, run: Run, known: Truths, meets: Callable[[Metrics], bool]
) -> list[str]:
    """Leave out failed metrics of angles that would fail with right ones (n,), rad, too.

    Also those of alarms that would pass with the run's own: then its probabilities of danger are wrong.
    """

    def mended(alpha: Array) -> list[str]:
        found = _metrics(alpha, run, known)
        return [what for what in failed if what in found and meets({what: found[what]})]

    of_danger = [what for what in mended(run.alpha) if what.startswith("alarm.")]
    of_angles = [what for what in mended(right) if what not in of_danger]
    return [what for what in failed if what in of_angles or not what.startswith(_OF_ANGLES)]


def _metrics(alpha: Array, run: Run, known: Truths) -> Metrics:
    """Metrics of other angles (n,), rad, with intervals as wide as the run's own, and alarms by the angles alone."""
    measured = by_angles(alpha)
    return flat({
        "angle": angles(alpha, known.alpha, known.rope_length, known.weather),
        "interval": coverage(run.ends + (alpha - run.alpha)[:, None], known.alpha),
        "alarm": None if run.time is None else alarms(run.time, measured, events(run.time, measured), known.alpha),
    })  # fmt: skip


def _rms(values: Array) -> float:
    """Root mean square of the finite values; 0 of none."""
    some = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(some**2))) if len(some) else 0.0


def _of_angles(measured: Array, true: Array) -> Iterator[str]:
    """State how angles (n,), degrees, differ from the true ones as a whole."""
    bias, rmse = float(np.mean(measured - true)), _rms(measured - true)
    spread, true_spread = float(measured.std()), float(true.std())
    if spread < true_spread / STILL:
        twice = 0.7 < math.radians(true_spread) / max(spread, 1e-9) < 1.4
        yield (
            f"The measured angle hardly follows the swing: its standard deviation is {spread:.2f}°, that of the true "
            f"swing {true_spread:.2f}°{', as if it were converted from degrees to radians twice' if twice else ''}."
        )
        return
    factor = float(measured @ true) / max(float(measured @ measured), 1e-12)
    scaled, moved = _rms(factor * measured - true), _rms(measured - true - bias)
    if factor > 0 and scaled < min(moved, rmse, 2 * true_spread) / 2:
        degrees = ", as if it were in degrees" if 0.9 < math.degrees(factor) < 1.1 else ""
        yield (
            f"Most of the error is a factor: the measured angle is {1 / factor:.2f} times the true one{degrees}. "
            f"Without it the RMSE would be {scaled:.2f}° instead of {rmse:.2f}°."
        )
    elif bias**2 > rmse**2 / 2:
        kind, size = "a constant", f"{abs(bias):.2f}° too {'large' if bias > 0 else 'small'}"
        left = f"{moved:.2f}°"
        if factor > 0 and scaled < min(CLEARLY * moved, true_spread):
            kind, size = f"{kind} or a factor", f"{size}, or {1 / factor:.2f} times the true one"
            left = f"{left} or {scaled:.2f}°"
        yield (
            f"Most of the error is {kind}: on average, the measured angle is {size}. Without it the RMSE would be "
            f"{left} instead of {rmse:.2f}°."
        )


def _of_stages(
    trial: Trial, run: Run, rmse: float, true_spread: float, *, compared: bool, steady: bool
) -> Iterator[str]:  # fmt: skip
    """Name the first stage of the pipeline that explains its RMSE of the angle: centre, tilt, or the rest."""
    later = (
        " This is about the whole error, of which another part may have grown since the baseline." if compared else ""
    )
    known, budget = trial.known, trial.evaluation.budget
    most = "" if budget is None else contributions(msgspec.to_builtins(budget.chain))
    centre_deg, tilt = np.rad2deg(_rms(swing_of(by_centres(run, known))[0] - known.alpha)), of_tilt(run, known)
    if trial.centres and centre_deg**2 > rmse**2 / 2 and not steady:
        off_px = float(np.quantile([c.off_px for c in trial.centres], 0.95))
        which, rest = "the centre first", None if budget is None else budget.chain[-2].rmse_deg
        more = f", those of this pipeline {rmse:.2f}°."
        if tilt and budget is not None and rest is not None and rest**2 > rmse**2 / 2:
            which, more = "centre and tilt", (
                f"; the tilt that is estimated from it hides a part. With true centres, simgrab's estimator "
                f"{budget.estimator} would have one of {rest:.2f}°, most of it by: {most}."
            )  # fmt: skip
        yield (
            f"Correct {which}: the centre's error (95th percentile) is {off_px:.1f} px. With all else true, angles "
            f"that follow from it have an RMSE of {centre_deg:.2f}°{more}{later}"
        )
        return
    if tilt and max(tilt.unlike_deg, tilt.rmse_deg) < rmse / 2:
        yield (
            f"Correct the tilt first: this pipeline's is {tilt.used.beta_deg:.2f}° with an azimuth of "
            f"{tilt.used.tilt_azimuth_deg:.0f}°, from {tilt.used.frames} frames; the true one is "
            f"{tilt.true.beta_deg:.2f}° with {tilt.true.tilt_azimuth_deg:.0f}°. With that, the RMSE would be "
            f"{tilt.rmse_deg:.2f}° instead of {rmse:.2f}°.{later}"
        )
        return
    if budget is None:
        return
    fed = budget.chain[-1].rmse_deg  # estimated from the run's own centres and lengths
    fed, own = math.inf if fed is None else fed, budget.run.rmse_deg or 0.0
    if own**2 <= 2 * fed**2:  # the angles' own computation adds less than all before it
        if round(own, 2) >= round(fed, 2):  # else the budget is of errors that this pipeline avoids
            yield (
                f"From the same centres and lengths, simgrab's estimator {budget.estimator} has an RMSE of {fed:.2f}°. "
                f"The largest contribution in its error budget: {most}.{later}"
            )
        elif (steady_deg := budget.chain[1].rmse_deg or 0.0) > rmse / 2:
            tilts = [row.beta_deg for row in known.rows if row is not None]
            yield (
                f"The camera's tilt changes, from {min(tilts):.1f}° to {max(tilts):.1f}°. With all else true, the best "
                f"tilt that does not change leaves an RMSE of {steady_deg:.2f}°; this pipeline has {rmse:.2f}°.{later}"
            )
    elif fed >= max(true_spread, rmse / 3):
        yield (
            f"Correct centre and rope length first: from them, simgrab's estimator {budget.estimator} computes angles "
            f"with an RMSE of {fed:.2f}°, which is no better than a constant angle."
        )
    else:
        read = any(m.rope_length_m is not None for m in run.measurements)
        inputs = "From the centres and rope lengths that this pipeline measured"
        yield (
            f"{inputs if read else 'From its centres and the true lengths'}, simgrab's estimator {budget.estimator} "
            f"computes angles with an RMSE of {fed:.2f}°: the error arises where this pipeline computes its angles."
        )

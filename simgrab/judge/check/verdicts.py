"""Judge each metric of a trial by its limits and by the baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec

from simgrab.judge.check import baseline as base
from simgrab.judge.check.baseline import Baseline, Reference
from simgrab.judge.check.metrics import unknown
from simgrab.judge.check.suite import Limit
from simgrab.judge.check.trial import Metrics, Trial, naive
from simgrab.judge.evaluate.detection import HALF

Status = Literal["passed", "failed", "skipped"]
_OF_CENTRES = ("detection.centre.", "detection.coverage.")
_LISTED = 10  # frames at most
_OF_EVENTS = ("alarm.median_delay", "alarm.recall", "warning.lead_s")
_FIELDS = {  # of a measurement, by the beginning of the figures that need it; the first that fits
    "angle.": "alpha", "alarm.": "alpha", "interval.": "alpha_low", "warning.peak_": "peak", "warning.": "warning",
    "detection.centre.": "centre", "detection.jitter_px": "centre", "detection.coverage.": "centre_sd",
    "detection.": "box", "reading.length.": "rope_length_m", "reading.": "rope_text",
}  # fmt: skip


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one check.

    Attributes
    ----------
    scene : str
        Empty for the suite as a whole.
    what : str
        A metric, a golden frame, the instrument, or the baseline.
    status : str
        ``"passed"``, ``"failed"``, or ``"skipped"`` where there was nothing to compare with.
    value : float or None
        Value of the metric.
    frames : str
        Of which frames the value is, where it leaves out some for which a centre was output.
    limit : str
        Text of the limit.
    reference, allowed : float or None
        Value of the baseline, and by how much the metric may be worse.
    constant, last_value : float or None
        What instruments without any picture would reach, see `simgrab.judge.check.trial.naive`.
    message : str
        What failed or was skipped, and why.
    """

    scene: str
    what: str
    status: Status
    value: float | None = None
    frames: str = ""
    limit: str = ""
    reference: float | None = None
    allowed: float | None = None
    constant: float | None = None
    last_value: float | None = None
    message: str = ""


def of_trial(
    scene: str, trial: Trial, limits: Mapping[str, Limit], recorded: Baseline | None, comparisons: int
) -> list[Verdict]:
    """Judge a trial by limits, and by a baseline if there is one.

    ``scene`` is its name in the suite; for ``comparisons`` see `simgrab.judge.check.baseline.reference`.
    """
    labels = trial.dataset.data.labels_sha256
    naive_metrics = naive(trial.known, limits, trial.run.time)
    result = []
    for metric, limit in limits.items():
        past = base.reference(recorded.scenes[scene], metric, limit, labels, comparisons) if recorded else None
        constant, last_value = naive_metrics.get(metric, (None, None))
        verdict = _of_metric(scene, metric, trial, limit, past)
        result.append(msgspec.structs.replace(verdict, constant=constant, last_value=last_value))
    return result


def passes(verdict: Verdict, value: float | None, limit: Limit) -> bool:
    """Whether another value of a verdict's metric would pass: the limit, and what the baseline allows."""
    if value is None or not limit.holds(value):
        return False
    past = verdict.reference, verdict.allowed
    return past[0] is None or past[1] is None or Reference(past[0], past[1], same_frames=True).holds(value, limit)


def surpasses(verdict: Verdict, limit: Limit) -> bool:
    """Whether a value is better than the baseline's by more than it might be worse."""
    if verdict.value is None or verdict.reference is None or verdict.allowed is None:
        return False
    return limit.excess(verdict.reference) - limit.excess(verdict.value) > verdict.allowed


def lax(verdicts: Sequence[Verdict], limits: Mapping[str, Limit]) -> list[Verdict]:
    """Return the verdicts on errors of the angle whose limits a constant answer meets.

    One on the bias, which a constant answer can always make 0, is among them only if all are.
    """
    angle = [one for one in verdicts if one.constant is not None and one.what.startswith("angle.")]
    met = [verdict for verdict in angle if limits[verdict.what].holds(verdict.constant or 0.0)]
    return met if len(met) == len(angle) else [v for v in met if not v.what.endswith(".bias_deg")]


def leaves_out(trial: Trial, verdicts: Sequence[Verdict]) -> str:
    """State which centres the figures leave out, if a verdict is on such a figure; else empty."""
    out = [c for c in trial.centres if not c.counted]
    if not out or not any(verdict.frames for verdict in verdicts):
        return ""
    listed = ", ".join(str(c.frame) for c in out[:_LISTED]) + ", …" * (len(out) > _LISTED)
    most = max(c.off_px for c in out)
    return (
        f"detection.centre leaves out {len(out)} of {len(trial.centres)} centres, up to {most:.0f} px off, whose box "
        f"overlaps the true one too little (IoU below {HALF}): frames {listed}"
    )


def _of_metric(scene: str, metric: str, trial: Trial, limit: Limit, past: Reference | None) -> Verdict:
    value, problems = trial.metrics.get(metric), []
    counted, total = sum(c.counted for c in trial.centres), len(trial.centres)
    partly = metric.startswith(_OF_CENTRES) and 0 < counted < total
    if value is None:
        problems.append(_nothing(metric, trial))
    else:
        if not limit.holds(value):
            problems.append(f"{value:.4g} misses the limit {limit}")
        if past and not past.holds(value, limit):
            of = "on the same frames" if past.same_frames else "over other seeds"
            more = f"{round(past.allowed, 8):.2g}"  # a slack of 0 is 0, whatever rounding adds
            problems.append(f"{value:.4g} is worse than the baseline's {past.value:.4g} {of} by more than {more}")
    return Verdict(
        scene=scene, what=metric, status="failed" if problems else "passed", value=value, limit=str(limit),
        reference=past.value if past else None, allowed=past.allowed if past else None, message="; ".join(problems),
        frames=f"{counted} of {total} frames" if partly else "",
    )  # fmt: skip


def _nothing(metric: str, trial: Trial) -> str:
    """Return why there is no value."""
    metrics = trial.metrics
    if metric.startswith(_OF_CENTRES) and trial.centres and not any(c.counted for c in trial.centres):
        return (
            f"no value: the figure is of frames whose box overlaps the true one (IoU of at least {HALF}), and none of "
            f"{len(trial.centres)} does"
        )
    if metric.startswith(("angle.", "interval.")) and metrics.get("frames.ok") == 0:
        return "no value: no frame has an angle"
    if metric.startswith(("alarm.", "warning.")) and metrics.get("alarm", 0) is None and not unknown(metric):
        return (
            "no value: alarms need frames in time, and this scene draws each on its own; give it swing.model = "
            '"dynamic", or move the limit into [scenes.NAME.limits] of one that has it, such as work-cycles'
        )
    if metric in _OF_EVENTS and (why := _without_event(metric, metrics)):
        return f"no value: {why}"
    if metric == "alarm.precision":
        return "no value: no frame is reported beyond 10°"
    if wrong := unknown(metric):
        return wrong
    field = next((field for start, field in _FIELDS.items() if metric.startswith(start)), None)
    if field and all(getattr(m, field) is None for m in trial.run.measurements):
        return f"no value: the instrument output no {field}"
    if metric.startswith("angle."):
        return "no value: no frame of that kind has a measured and a true angle"
    return "no value: the scene has no such data"


def _without_event(metric: str, metrics: Metrics) -> str:
    """Return why no event of the true swing has a value; empty if that is not the reason."""
    part, _, name = metric.partition(".")
    events = metrics.get(f"{part}.events")
    if events is None:
        return ""
    if not events:
        return f"the true swing never exceeds {'10.5' if part == 'warning' else '10'}°"
    if name == "recall":
        return "no frame beyond 10° has an angle"
    on = metrics.get("alarm.already_on") or 0 if part == "alarm" else 0
    found = ((on, "began while an alarm was on already"), (events - on, f"raised no {part}"))
    counts = " and ".join(f"{count:.0f} {how}" for count, how in found if count)
    return f"of {events:.0f} event{'s' * (events > 1)} of the true swing, {counts}"

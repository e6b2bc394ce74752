"""A run in figures: a summary, and the paper's table for the paper's video."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgrab.instrument.angles import NORMAL
from simgrab.instrument.controller import CLOCK, in_words
from simgrab.instrument.estimate import PaperIteration
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.instrument.run.assumed import CONTRADICTS
from simgrab.instrument.run.runs import Run
from simgrab.model.geometry import Array

Row = tuple[str, str, str, str]
MOST_FAULTS, MOST_ONSETS = 40, 6  # that are listed
SURE_ROLL_DEG = 2.0
HEAD = ("", "the paper's video", "the paper's method", "this run")
# Section 4.5 and its appendix: 3,699 frames by day, in the order of `measured`.
_PUBLISHED = ("3699", "2.530", "2.664", "over 95 %", "10.010")


def beside_paper(run: Run) -> list[Row]:
    """Compare the paper's table with the results of its method, and of the run's own, on the same frames."""
    paper, own = PaperIteration().estimate(run.pixels, run.calibration), run.about["estimate"] or {}
    beta_deg = None if paper.beta is None else float(np.rad2deg(paper.beta))
    again = _figures(np.empty(0) if paper.alpha is None else paper.alpha, beta_deg)
    iterations = str(paper.diagnostics["iterations"]) if paper.ok else f"refused: {paper.reason}"
    return [
        *(
            (name, published, theirs, ours)
            for published, (_, theirs), (name, ours) in zip(_PUBLISHED, again, measured(run), strict=True)
        ),
        ("iterations", "8", iterations, str(own.get("diagnostics", {}).get("iterations", ""))),
    ]


def measured(run: Run) -> list[tuple[str, str]]:
    """Return the run's own tilt and swing; empty if there is none."""
    found = _figures(run.alpha, (run.about["tilt"] or {}).get("beta_deg"))
    if not np.isfinite(run.alpha).any():
        return found
    frame = int(np.nanargmax(run.alpha))
    one, largest = run.measurements[frame], found[-1][1]
    if one.alpha_low is not None and one.alpha_high is not None:
        largest += f" ({np.rad2deg(one.alpha_low):.2f} to {np.rad2deg(one.alpha_high):.2f}, 95 %)"
    if one.direction is not None:
        largest += f" towards {np.rad2deg(one.direction):.0f}°"
    when = f"frame {frame}" if run.time is None else f"{run.time[frame]:.1f} s"
    return [*found[:-1], (found[-1][0], f"{largest} at {when}")]


def _figures(alpha: Array, beta_deg: float | None) -> list[tuple[str, str]]:
    degrees = np.rad2deg(alpha[np.isfinite(alpha)])
    sigma, below, largest = (
        (float(np.sqrt(np.mean(degrees**2))), float(np.mean(degrees <= 5)), float(degrees.max()))
        if len(degrees)
        else (None, None, None)
    )
    return [
        ("frames with an angle", str(len(degrees))),
        ("tilt β̂ (deg)", number(beta_deg)),
        ("swing σ̂ (deg)", number(sigma)),
        ("α̂ at most 5°", percent(below)),
        ("largest α̂ (deg)", number(largest)),
    ]


def held(run: Run) -> list[tuple[str, str]]:
    """Summarise a run: frames by status, readings, alarms, speed."""
    n, speed = len(run.measurements), run.about["speed"]
    read = sum(m.rope_status == "read" for m in run.measurements)
    asked = sum(bool(m.rope_status) for m in run.measurements)
    rows = [
        ("source", run.source),
        *(("  note", note) for note in run.about.get("notes", ()) if not note.startswith(CONTRADICTS)),
    ]
    rows += [("camera", run.about["camera"])] if "camera" in run.about else []
    rows += [("instrument", run.instrument), ("frames", str(n))]
    rows += [
        (f"  {name}", f"{count} ({100 * count / n:.2f} %)") for name, count in run.about["counts"].items() if count
    ]
    if asked:
        rows.append(("rope lengths read", f"{read} of {asked} ({100 * read / asked:.3f} %)"))
    if reported := run.about.get("controller"):
        clock = in_words(
            *(reported[f"clock_{name}"] for name in ("offset_s", "interval_s", "from", "by_motion_interval_s"))
        )
        found = [f["text"] for f in run.about.get("faults", ()) if f["text"].startswith(CLOCK)]
        rows.append(("controller's clock", f"{found[-1].removeprefix(CLOCK)}; at first {clock}" if found else clock))
        rows += [("controller's wind", f"{wind:.1f} m/s")] if (wind := reported.get("wind_m_s")) else []
        if (why := reported.get("load_unused")) is not None:
            used = "used: a light grab leans more in the wind"
            rows.append(("controller's load", f"not used: {why}" if why else used))
    estimate = run.about["estimate"]
    if estimate is not None:
        refusal = "" if estimate["status"] == "ok" else f": refused, {estimate['reason']}"
        rows.append(("estimator", estimate["estimator"] + refusal))
        rows += _intervals(estimate, timed=run.time is not None)
        if (roll := estimate["diagnostics"].get("roll_deg")) is not None:
            within = NORMAL * estimate["diagnostics"]["roll_sd_deg"]
            state = "; state it as roll_deg in the camera file" if within < SURE_ROLL_DEG else ""
            rows.append(("roll", f"{roll:.1f} ± {within:.1f} deg by the swing{state}"))
            if (tilt := run.about["tilt"]) is not None and estimate["tilt_azimuth_deg"] is not None:
                with_it, stated = estimate["tilt_azimuth_deg"], tilt["tilt_azimuth_deg"]
                by = f"in tilt.toml by the camera file's roll of {tilt['roll_deg']:g} deg"
                rows.append(("tilt's azimuth", f"{with_it:.0f} deg by this roll; {stated:.0f} deg {by}"))
    elif run.about["tilt"] is not None:
        rows.append(("estimator", run.about["tilt"]["estimator"]))
    if (radius_m := (run.about["tilt"] or {}).get("radius_m")) is not None:
        pitch, sd = math.hypot(*run.about["tilt"]["pitch_deg_per_m"]), run.about["tilt"]["pitch_sd_deg_per_m"]
        by = f"{pitch:.2f} ± {NORMAL * sd:.2f} deg for each metre of radius"
        rows.append(("pitch", f"{by}; the tilt is that at {radius_m:.1f} m"))
    for name, key in (("95 % intervals", "text"), ("warning", "leans"), (CONTRADICTS, "beyond")):
        text = run.about.get("assumed", {}).get(key)
        rows += [(name, text)] if text else []
    above = run.about.get("above_10_deg", {})
    if above.get("share") is not None:
        ends = "" if above["low"] is None else f" ({percent(above['low'])} to {percent(above['high'])}, 95 %)"
        rows.append(("frames with α above 10°", f"{percent(above['share'])}{ends}"))
    alarms = _counted([event.onset_s for event in run.events])
    rows.append(("alarms", alarms if run.time is not None else "none: the frames are independent"))
    if any(m.warning is not None for m in run.measurements):
        rows.append(("early warnings", _counted([warning["onset_s"] for warning in run.about["warnings"]])))
    elif run.time is not None and estimate is not None and estimate["status"] == "ok":
        known = np.isfinite(run.rope_length).any()
        without = "more than a second, and --live if --imu or --plc measures the motion" if known else "rope lengths"
        rows.append(("early warnings", f"none: they need {without}"))
    if "faults" in run.about:
        faults = run.about["faults"]
        rows.append(("faults", str(len(faults))))
        rows += [(f"  {f['kind']}, {f['time_s']:.0f} s", f["text"]) for f in faults[:MOST_FAULTS]]
    rows.append(("speed", f"{speed['frames_per_s']:.1f} frames/s"))
    if "latency_p99_s" in speed:
        rows.append(("latency, 99 %", f"{1e3 * speed['latency_p99_s']:.0f} ms"))
    return rows


def _counted(onsets_s: Sequence[float]) -> str:
    """Write the number of events, and when the first ones begin."""
    times = ", ".join(f"{onset_s:.1f}" for onset_s in onsets_s[:MOST_ONSETS])
    more = ", …" if len(onsets_s) > MOST_ONSETS else ""
    return f"{len(onsets_s)}{f', at {times}{more} s' if times else ''}"


def _intervals(estimate: Mapping[str, Any], *, timed: bool) -> list[tuple[str, str]]:
    """State the tilt's interval, and what the intervals of a whole record assume to be independent."""
    stated = {i["kind"]: i for i in estimate["intervals"] if i["beta_deg"] is not None}
    if not stated:
        return []
    low, high = stated.get("blocks", next(iter(stated.values())))["beta_deg"]
    of_tilt = [("tilt, 95 %", f"{low:.2f} to {high:.2f} deg")]
    if "posterior" in stated:
        return of_tilt
    return [*of_tilt, ("95 % intervals by", f"frames that are {WORKING.apart_s:g} s apart" if timed else "frames")]


def number(value: float | None, digits: int = 3) -> str:
    """Write a number; empty for None."""
    return "" if value is None else f"{value:.{digits}f}"


def percent(value: float | None, digits: int = 1) -> str:
    """Write a share; empty for None."""
    return "" if value is None else f"{100 * value:.{digits}f} %"

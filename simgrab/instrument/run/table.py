"""A run in figures: what it holds, and the paper's table of its own video beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simgrab.instrument.estimate import PaperIteration
from simgrab.instrument.estimate.measure import estimate_json
from simgrab.instrument.run.runs import Run

Row = tuple[str, str, str, str]
HEAD = ("", "the paper's video", "the paper's method", "this run")
# Section 4.5 and its appendix: 3,699 frames by day.
_PUBLISHED = {"beta_deg": "2.530", "sigma_deg": "2.664", "below": "over 95 %", "largest": "10.010", "iterations": "8"}


def by_paper(run: Run) -> dict[str, Any]:
    """Estimate by the paper's method from a run's centres, with the figures that the paper gives for its own video."""
    if "paper" in run.about:
        return dict(run.about["paper"])
    found = PaperIteration().estimate(run.pixels, run.calibration)
    figures: dict[str, Any] = {"share_below_5": None, "largest_alpha_deg": None}
    if found.alpha is not None:
        alpha = np.rad2deg(found.alpha[np.isfinite(found.alpha)])
        figures = {"share_below_5": float(np.mean(alpha <= 5)), "largest_alpha_deg": float(alpha.max())}
    return estimate_json(found) | figures


def beside_paper(run: Run) -> list[Row]:
    """Put the paper's table beside what its method, and the run's own, make of the same frames."""
    paper, own = by_paper(run), run.about["estimate"] or {}
    refused = paper["status"] != "ok"
    published_and_again = [
        ("3699", str(paper["frames"])),
        (_PUBLISHED["beta_deg"], _number(paper["beta_deg"])),
        (_PUBLISHED["sigma_deg"], _number(paper["sigma_deg"])),
        (_PUBLISHED["below"], _percent(paper["share_below_5"])),
        (_PUBLISHED["largest"], _number(paper["largest_alpha_deg"])),
    ]
    iterations = "refused: " + paper["reason"] if refused else str(paper["diagnostics"]["iterations"])
    return [
        *((name, *two, value) for (name, value), two in zip(measured(run), published_and_again, strict=True)),
        ("iterations", _PUBLISHED["iterations"], iterations, str(own.get("diagnostics", {}).get("iterations", ""))),
    ]


def measured(run: Run) -> list[tuple[str, str]]:
    """Give the run's own tilt and swing; empty where there is none."""
    alpha = np.rad2deg(run.alpha[np.isfinite(run.alpha)])
    sigma, below, largest = (
        (float(np.sqrt(np.mean(alpha**2))), float(np.mean(alpha <= 5)), float(alpha.max()))
        if len(alpha)
        else (None, None, None)
    )
    return [
        ("frames with an angle", str(len(alpha))),
        ("tilt β̂ (deg)", _number((run.about["tilt"] or {}).get("beta_deg"))),
        ("swing σ̂ (deg)", _number(sigma)),
        ("α̂ at most 5°", _percent(below)),
        ("largest α̂ (deg)", _number(largest)),
    ]


def held(run: Run) -> list[tuple[str, str]]:
    """Tell what a run holds: frames by status, readings, alarms, speed."""
    n, speed = len(run.measurements), run.about["speed"]
    read = sum(m.rope_status == "read" for m in run.measurements)
    asked = sum(bool(m.rope_status) for m in run.measurements)
    rows = [("source", run.source), *(("  note", note) for note in run.about.get("notes", ()))]
    rows += [("instrument", run.instrument), ("frames", str(n))]
    rows += [
        (f"  {name}", f"{count} ({100 * count / n:.2f} %)") for name, count in run.about["counts"].items() if count
    ]
    if asked:
        rows.append(("rope lengths read", f"{read} of {asked} ({100 * read / asked:.3f} %)"))
    estimate = run.about["estimate"]
    if estimate is not None:
        refusal = "" if estimate["status"] == "ok" else f": refused, {estimate['reason']}"
        rows.append(("estimator", estimate["estimator"] + refusal))
        rows += _intervals(estimate, timed=run.time is not None)
    rows.append(("alarms", str(len(run.events)) if run.time is not None else "none: the frames are independent"))
    rows.append(("speed", f"{speed['frames_per_s']:.1f} frames/s"))
    if "latency_p99_s" in speed:
        rows.append(("latency, 99 %", f"{1e3 * speed['latency_p99_s']:.0f} ms"))
    return rows


def _intervals(estimate: Mapping[str, Any], *, timed: bool) -> list[tuple[str, str]]:
    """Tell what the intervals of a whole record take for independent."""
    stated = {i["kind"]: i for i in estimate["intervals"] if i["beta_deg"] is not None}
    if "posterior" in stated or not stated:
        return []
    if "blocks" in stated:
        return [("95 % intervals by", f"{stated['blocks']['blocks']} stretches of the record")]
    if not timed:
        return [("95 % intervals by", "frames")]
    few = next((i["note"] for i in estimate["intervals"] if i["kind"] == "blocks"), "")
    return [
        ("95 % intervals by", "frames; too narrow, because frames are not independent" + (f" ({few})" if few else ""))
    ]


def _number(value: Any) -> str:
    return "" if value is None else f"{value:.3f}"


def _percent(value: Any) -> str:
    return "" if value is None else f"{100 * value:.1f} %"

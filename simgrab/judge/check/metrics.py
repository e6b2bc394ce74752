"""Names of the metrics that a suite may limit: the numbers of `simgrab.evaluate`, by dotted name, and a time."""

from __future__ import annotations

from typing import get_type_hints

import msgspec

from simgrab.io.resources import suggestion
from simgrab.judge.evaluate import values
from simgrab.judge.evaluate.detection import ROPE_BINS_M

_MEAN = ("mean_px", "se_px", "mean_share")


def _numbers(kind: type[msgspec.Struct]) -> list[str]:
    """Fields of a struct that hold one number or None."""
    hints = get_type_hints(kind)
    return [name for name, hint in hints.items() if hint in (int, float, int | None, float | None)]


_ERRORS = _numbers(values.AngleErrors)
_PARTS: dict[str, list[str]] = {
    "frames": _numbers(values.FrameCounts), "detection": _numbers(values.DetectionScore),
    "detection.centre": [
        "frames", "median_px", "p95_px", "median_share", "median_of_diagonal", "p95_of_diagonal", "width_px",
        *(f"{way}_{name}" for way in ("u", "v", "radial", "box_radial") for name in _MEAN),
    ],
    "detection.coverage": ["centre"],
    **{f"reading.{name}": _numbers(values.Share) for name, kind in get_type_hints(values.ReadingScore).items()
       if kind is values.Share},
    "reading": ["jumps"], "reading.length": _numbers(values.Lengths),
    **{f"angle.{name}": _ERRORS for name in ("overall", "above_8_deg", *(f"by_rope.{name}" for name in ROPE_BINS_M))},
    "interval": _numbers(values.Coverage), "alarm": _numbers(values.Alarms),
    "warning": _numbers(values.Warnings),
    "budget.drawn": _ERRORS, "budget.run": _ERRORS,
}  # fmt: skip
TIME = "time.per_frame_s"
NAMES = frozenset([TIME, *(f"{part}.{name}" for part, names in _PARTS.items() for name in names)])
COUNTS = frozenset(
    name
    for kind in (values.FrameCounts, values.DetectionScore, values.Share, values.ReadingScore, values.Lengths,
                 values.AngleErrors, values.Coverage, values.Alarms, values.Warnings)
    for name, hint in get_type_hints(kind).items() if hint in (int, int | None)
)  # fmt: skip
_BY_WEATHER = "angle.by_weather."  # and a weather's name, which is the scene's affair


def unknown(metric: str) -> str:
    """Return that there is no such metric, and the nearest name; empty if there is one."""
    part, _, name = metric.rpartition(".")
    if metric in NAMES or (part.startswith(_BY_WEATHER) and name in _ERRORS):
        return ""
    return f"no metric {metric!r}{suggestion(metric, sorted(NAMES))}; docs/instrument.md names them"

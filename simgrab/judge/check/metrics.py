"""Names of the metrics that a suite may limit: the numbers of `simgrab.evaluate`, by dotted name."""

from __future__ import annotations

from simgrab.io.resources import suggestion
from simgrab.judge.evaluate.detection import ROPE_BINS_M

_ERRORS = ("frames", "bias_deg", "rmse_deg", "p95_deg", "max_deg")
_MEAN = ("mean_px", "se_px", "mean_share")
_PARTS: dict[str, tuple[str, ...]] = {
    "frames": ("all", "known", "ok", "missed", "unread", "lost", "refused"),
    "detection": (
        "frames", "labelled", "empty", "map50_95", "map50", "recall", "longest_miss", "false_boxes", "false_share",
        "labelled_worlds", "missed_worlds", "empty_worlds", "false_worlds", "jitter_px",
    ),
    "detection.centre": (
        "frames", "median_px", "p95_px", "median_share", "median_of_diagonal", "p95_of_diagonal", "width_px",
        *(f"{way}_{name}" for way in ("u", "v", "radial", "box_radial") for name in _MEAN),
    ),
    "detection.coverage": ("centre",),
    **{
        f"reading.{what}_{how}": ("count", "of", "value")
        for what in ("digits", "frames", "torn") for how in ("right", "refused")
    },
    "reading": ("jumps",),
    "reading.length": ("frames", "median_m", "p95_m", "max_m"),
    "angle.overall": _ERRORS, "angle.above_8_deg": _ERRORS,
    **{f"angle.by_rope.{name}": _ERRORS for name in ROPE_BINS_M},
    "interval": ("frames", "share", "width_deg"),
    "alarm": ("events", "sure", "missed", "reported", "false", "already_on", "median_delay", "precision", "recall"),
    "budget.drawn": _ERRORS, "budget.run": _ERRORS,
}  # fmt: skip
NAMES = frozenset(f"{part}.{name}" for part, names in _PARTS.items() for name in names)
_BY_WEATHER = "angle.by_weather."  # and a weather's name, which is the scene's affair


def unknown(metric: str) -> str:
    """Say that there is no such metric, and which comes close; empty where there is."""
    part, _, name = metric.rpartition(".")
    if metric in NAMES or (part.startswith(_BY_WEATHER) and name in _ERRORS):
        return ""
    return f"no metric {metric!r}{suggestion(metric, sorted(NAMES))}; docs/instrument.md names them"

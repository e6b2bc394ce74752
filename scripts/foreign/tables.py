"""Markdown of the foreign exam's scores, and its goals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from scripts.foreign.worlds import CONDITIONS, beside

LEAST_RECALL, LEAST_COVERAGE, MOST_FALSE = 0.97, 0.90, 0.005
LEAST_MAP_LESS, LARGEST_RATIO = -0.05, 1.5
DASH = "–"
COVERED = ("box", "centre", "yaw")

Figures = Mapping[str, Any]


def report(scores: Mapping[str, Any]) -> str:
    """Markdown of all that `scripts.foreign_exam.score` gives."""
    parts = [f"Worlds: {scores['worlds']} complete, {len(scores['incomplete'])} not.\n"]
    for detector, rows in scores["detectors"].items():
        parts.append(f"## {detector}\n")
        if "all" in rows:
            parts.append(goals(rows["all"]))
        parts.append(table("condition", {f"`{name}`": row for name, row in rows.items()}))
        for kind, members in scores["groups"].get(detector, {}).items():
            lines = {f"`{name}`, {value}": members[value][name] for name in rows for value in members}
            parts += [f"### {detector} by {kind}\n", table(f"condition, {kind}", lines)]
    parts += ["## Reader\n", digits(scores["digits"])]
    parts += ["## Masks\n", *(f"- {name}: {_agreement(ids)}" for name, ids in scores["ids"].items())]
    return "\n".join(parts) + "\n"


def goals(row: Mapping[str, Any]) -> str:
    """Markdown of the goals with everything foreign, each met, short or not measured."""
    f, less = row["foreign"], row["difference"]
    covered = [value for value in f["coverage"].values() if value is not None]
    least = min(covered, default=None)
    lines = [
        ("recall at least 97 %", _recall(f), _met(f["recall"], lambda v: v >= LEAST_RECALL)),
        ("mAP50-95 at most 0.05 below MuJoCo's", _less(less),
         _met(less["map50_95_less"], lambda v: v >= LEAST_MAP_LESS)),
        ("centre's median error at most 1.5 times MuJoCo's", _ratio(less),
         _met(less["median_ratio"], lambda v: v <= LARGEST_RATIO)),
        ("95 % intervals cover at least 90 %: box, centre, yaw", ", ".join(_coverage(f, key) for key in COVERED),
         _met(least, lambda v: v >= LEAST_COVERAGE)),
        ("boxes on at most 0.5 % of frames without a grab", _false(f),
         _met(f["false_share"], lambda v: v <= MOST_FALSE)),
    ]  # fmt: skip
    return markdown(("goal with everything foreign", "measured", "by the estimate"), lines)


def _met(value: float | None, holds: Callable[[float], bool]) -> str:
    return "not measured" if value is None else "met" if holds(value) else "short"


def table(head: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown of comparisons, two lines for each: the pictures of a condition, and MuJoCo's of the same worlds."""
    heads = (
        head, "by", "grabs found", "mAP50-95", "less MuJoCo's", "centre: median, px", "over MuJoCo's", "95 %, px",
        "median, % of diagonal", "95 %, % of diagonal", "covered: box", "covered: centre", "covered: yaw",
        "boxes on empty frames",
    )  # fmt: skip
    lines = []
    for name, row in rows.items():
        less = row["difference"]
        lines.append(_line(name, "Blender", row["foreign"], _less(less), _ratio(less)))
        lines.append(_line("", "MuJoCo", row["mujoco"], "", ""))
    return markdown(heads, lines)


def _line(name: str, by: str, figures: Figures, less: str, ratio: str) -> Sequence[str]:
    centre, spread = figures["centre"], figures["intervals"]
    return (
        name, by, _recall(figures), _n(figures["map50_95"], spread["map50_95"]), less,
        _n(centre.get("median_px"), spread["median_px"], ".1f"), ratio,
        _n(centre.get("p95_px"), spread["p95_px"], ".1f"),
        *(_share(centre.get(key), spread[key], 2) for key in ("median_of_diagonal", "p95_of_diagonal")),
        *(_coverage(figures, key) for key in COVERED), _false(figures),
    )  # fmt: skip


def digits(rows: Mapping[str, Any]) -> str:
    """Markdown of how the reader did, beside MuJoCo's pictures of the same worlds."""
    lines = []
    for name in (name for name in CONDITIONS if name in rows and name != beside(CONDITIONS[name])):
        for by, one in (("Blender", rows[name]), ("MuJoCo", rows[beside(CONDITIONS[name])])):
            cells = [_counted(one[key]) for key in ("digits_right", "digits_refused")] if one else [DASH, DASH]
            lines.append((f"`{name}`" if by == "Blender" else "", by, *cells))
    return markdown(("condition", "by", "digits right of those read", "digits refused"), lines)


def _agreement(ids: Mapping[str, Any]) -> str:
    farthest = DASH if ids["farthest_px"] is None else f"{ids['farthest_px']:.1f} px"
    return (
        f"{ids['within_a_pixel']} of {ids['frames']} masks agree with the path tracer's ids within a pixel. "
        f"{ids['pixels_beyond']} of {ids['pixels']} pixels are farther away, {farthest} at most. In {ids['one_sided']} "
        f"frames only one of the two shows a grab. IoU {ids['median_iou']:.4f} in the median, {ids['least_iou']:.4f} "
        "at least."
    )


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Make a table."""
    rows = [heads, ["---"] * len(heads), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def _n(value: float | None, interval: Sequence[float] | None, how: str = ".3f") -> str:
    if value is None:
        return DASH
    return f"{value:{how}}" + ("" if interval is None else f" ({interval[0]:{how}} to {interval[1]:{how}})")


def _share(value: float | None, interval: Sequence[float] | None, digits: int = 1) -> str:
    if value is None:
        return DASH
    return _n(100 * value, interval and [100 * end for end in interval], f".{digits}f")


def _recall(figures: Figures) -> str:
    share, of, interval = figures["recall"], figures["labelled"], figures["recall_interval"]
    return DASH if share is None else f"{round(share * of)} of {of} ({_percent(interval)})"


def _false(figures: Figures) -> str:
    of, interval = figures["empty"], figures["false_interval"]
    return f"{figures['false_boxes']} of {of} ({_percent(interval)})" if of else DASH


def _percent(interval: Sequence[float]) -> str:
    return f"{100 * interval[0]:.1f} to {100 * interval[1]:.1f} %"


def _coverage(figures: Figures, key: str) -> str:
    text = _share(figures["coverage"][key], figures["intervals"][key])
    return text if text == DASH else f"{text} %"


def _less(difference: Figures) -> str:
    return _n(difference["map50_95_less"], difference["intervals"]["map50_95_less"], "+.3f")


def _ratio(difference: Figures) -> str:
    return _n(difference["median_ratio"], difference["intervals"]["median_ratio"], ".2f")


def _counted(share: Mapping[str, Any]) -> str:
    return f"{share['count']} of {share['of']}" + (f" ({_percent(share['interval'])})" if share["of"] else "")

"""An evaluation as tables of text, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simgrab.instrument.run.table import number, percent


@dataclass(frozen=True)
class TextTable:
    """A table of text: title, heads, rows and a note below."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


ERRORS = ("frames", "bias", "RMSE", "95 %", "max")  # degrees


def tables(evaluation: Mapping[str, Any]) -> tuple[TextTable, ...]:
    """Make the tables of an `Evaluation`; parts without a comparison are left out."""
    parts = (
        _of_detection(evaluation["detection"]),
        _of_reading(evaluation["reading"]),
        _of_angle(evaluation["angle"], evaluation["interval"], evaluation["run"], evaluation["frames"]["without_grab"]),
        _of_alarm(evaluation["alarm"]),
        _of_warning(evaluation["warning"]),
        _of_budget(evaluation["budget"]),
    )
    return tuple(part for part in parts if part is not None)


def _of_detection(f: Mapping[str, Any] | None) -> TextTable | None:
    if f is None:
        return None
    centre = f["centre"]
    low, high = f["recall_interval"] or (None, None)
    recall = f["recall"]
    rows = (
        ("COCO mAP@50:95", number(f["map50_95"])),
        (
            f"recall of {f['labelled']} frames with a grab",
            "" if recall is None else f"{number(recall, 4)} ({number(low, 4)} to {number(high, 4)})",
        ),
        ("most missed in a row", number(f["longest_miss"], 0)),
        (f"boxes on {f['empty']} frames without one", number(f["false_boxes"], 0)),
        ("centre error, median (px)", number(centre.get("median_px"), 2)),
        ("centre error, 95 % (px)", number(centre.get("p95_px"), 2)),
        ("centre bias u, v (px)", _several(centre.get("u_mean_px"), centre.get("v_mean_px"), digits=2)),
        ("jitter (px)", number(f["jitter_px"], 2)),
        ("coverage of the stated 95 % of the centre", percent(f["coverage"]["centre"])),
    )
    return TextTable("Detection", ("", ""), _known(rows))


def _of_reading(f: Mapping[str, Any] | None) -> TextTable | None:
    if f is None:
        return None
    length = f["length"]

    def share(name: str) -> str:
        return f"{f[name]['count']} of {f[name]['of']} ({percent(f[name]['value'], 3)})" if f[name]["of"] else "none"

    lengths = ("rope's length, median and 95 % error (m)", _several(length["median_m"], length["p95_m"]))
    if not (f["frames_right"]["of"] or f["torn_right"]["of"]):  # there was no display to read
        return TextTable("Reading", ("", ""), _known((lengths,)))
    rows = (
        ("digits right", share("digits_right")),
        ("frames read right", share("frames_right")),
        ("frames refused", share("frames_refused")),
        ("torn displays read as one text", share("torn_right")),
        ("readings that the hoist is too slow to have reached", str(f["jumps"])),
        lengths,
    )
    return TextTable("Reading", ("", ""), _known(rows), "The display lags behind the rope.")


def _of_angle(
    f: Mapping[str, Any], interval: Mapping[str, Any], run: Mapping[str, Any], without_grab: int
) -> TextTable:  # fmt: skip
    rows = [("all", *errors(f["overall"])), ("α above 8°", *errors(f["above_8_deg"]))]
    rows += [(f"rope {name}", *errors(e)) for name, e in f["by_rope"].items() if e["frames"]]
    rows += [(name, *errors(e)) for name, e in f["by_weather"].items()]
    note = "No intervals were given."
    if interval["share"] is not None:
        width = number(interval["width_deg"], 2)
        note = f"95 % intervals cover the true α in {percent(interval['share'])}, at a mean width of {width}°."
    of_nothing = f"{without_grab} angles are of frames without a grab." if without_grab else ""
    notes = " ".join(filter(None, (run["unit"], note, of_nothing, run["still"], run["camera"], run["matched"])))
    return TextTable("Errors of the swing angle, degrees", ("", *ERRORS), tuple(rows), notes)


def _of_alarm(f: Mapping[str, Any] | None) -> TextTable | None:
    if f is None:
        return None
    delay = "no alarm" if f["median_delay"] is None else f"{f['median_delay']:g} ({', '.join(map(str, f['delays']))})"
    rows = (
        ("true swings beyond 10°, events", str(f["events"])),
        ("of these beyond 10.5°", str(f["sure"])),
        ("of these missed", str(f["missed"])),
        ("alarms", str(f["reported"])),
        ("of these false (true swing below 9.5°)", str(f["false"])),
        ("median delay, and each (frames)", delay),
        (
            "frames beyond 10°: precision, recall",
            f"{number(f['precision']) or 'no alarm'}, {number(f['recall']) or 'no such frame'}",
        ),
    )
    return TextTable("Alarms", ("", ""), rows)


def _of_warning(f: Mapping[str, Any] | None) -> TextTable | None:
    if f is None:
        return None
    rows = (
        ("true swings beyond 10.5°, events", str(f["events"])),
        ("of these without a warning, and with a late one", f"{f['missed']}, {f['late']}"),
        ("median lead (s)", number(f["lead_s"], 1)),
        ("warnings", str(f["reported"])),
        ("of these false, and per hour", f"{f['false']}, {number(f['false_per_h'], 1)}"),
        (f"reliability in {f['unsure']} frames between 5 % and 95 %", percent(f["reliability"])),
        ("next peak, RMSE (deg)", number(f["peak_rmse_deg"], 2)),
        ("if the last one persists", number(f["persist_rmse_deg"], 2)),
        ("of an undamped pendulum from two frames", number(f["two_frames_rmse_deg"], 2)),
        ("coverage of its 95 % intervals", percent(f["peak_coverage"])),
        ("mean width of these intervals (deg)", number(f["peak_width_deg"], 1)),
    )
    return TextTable("Early warnings", ("", ""), _known(rows), "The lead is at most 6 s.")


def _of_budget(f: Mapping[str, Any] | None) -> TextTable | None:
    if f is None:
        return None
    groups = (
        ("", (*f["chain"], f["run"])), ("no truth, ", [f["drawn"]]), ("single inputs: ", f["aside"]),
        ("the paper's method: ", f["paper"]),
    )  # fmt: skip
    rows = [
        (f"{prefix}{row['stage']}", *errors(row), number(row.get("beta_deg")))
        for prefix, rows in groups
        for row in rows
    ]
    return TextTable(
        f"Error budget of the swing angle, degrees (all but the run itself by {f['estimator']})",
        ("oracle inputs", *ERRORS, "β̂"), tuple(rows),
        "Each row down to the run itself replaces one more oracle input by the measured one; all use the same frames. "
        + ("The tilt was given, or estimated from part of the frames. " if f["tilt"] == "given" else "")
        + f"Largest contribution: {f['limit']}.",
    )  # fmt: skip


def _known(rows: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
    """Leave out rows without a value."""
    return tuple(row for row in rows if row[1])


def _several(*values: Any, digits: int = 3) -> str:
    """Write numbers in a row; empty if one is missing."""
    return "" if None in values else ", ".join(number(value, digits) for value in values)


def errors(e: Mapping[str, Any]) -> tuple[str, ...]:
    """Cells of a row of errors."""
    return (str(e["frames"]), *(number(e[name]) for name in ("bias_deg", "rmse_deg", "p95_deg", "max_deg")))

"""A run as one HTML page, with a step in which the operator confirms the alarms."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from simgrab.instrument.alarm import Event
from simgrab.instrument.run import figures as run_figures
from simgrab.instrument.run.runs import Run, alarms
from simgrab.instrument.run.table import HEAD, beside_paper, held
from simgrab.pages import html

MOST_STILLS = 40  # alarms that come with a picture

# Keeps what is ticked in the browser, and hands it out as alarms.json with `confirmed` filled in.
_CONFIRM = """
<p><button id="keep" type="button">Save decisions (alarms.json)</button> <span id="told"></span></p>
<script id="events" type="application/json">%s</script>
<script>
"use strict";
const events = JSON.parse(document.getElementById("events").textContent);
const told = document.getElementById("told");
const tell = () => {
  const open = events.filter((event) => event.confirmed === null).length;
  told.textContent = open ? open + " of " + events.length + " not yet confirmed" : "all confirmed";
};
for (const input of document.querySelectorAll("input[data-event]"))
  input.addEventListener("change", () => { events[input.dataset.event - 1].confirmed = input.value; tell(); });
document.getElementById("keep").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(events, null, 1)], { type: "application/json" }));
  link.download = "alarms.json";
  link.click();
  URL.revokeObjectURL(link.href);
});
tell();
</script>
"""


def page(run: Run, stills: Mapping[int, bytes]) -> str:
    """Write the page; ``stills`` are annotated JPEGs by frame."""
    rows = [list(row) for row in held(run)]
    parts = [
        html.table(["", ""], rows),
        html.section("Alarms", _alarms(run, stills)),
        html.section("Swing over time", html.drawing(
            run_figures.trace(run), "trace", "Bands: alarms. Ticks at the foot: frames without an angle, and why.")),
        html.section("Largest swing", _largest(run, stills)),
        html.section("Rope length", html.drawing(
            run_figures.rope(run), "rope", "As read on the display, with the display's constant added.")),
        html.section("In the picture", html.drawing(
            run_figures.plane(run), "plane", "The grab's centre in every frame, without the lens' distortion.")),
        html.section("Histogram", html.drawing(run_figures.histogram(run), "histogram", "Frames by swing angle.")),
        html.section("Beside the paper", html.table(list(HEAD), [list(r) for r in beside_paper(run)], {1, 2, 3})),
        html.section("Frames without an angle", _reasons(run)),
    ]  # fmt: skip
    return html.page(f"Run on {run.source}", html.text(run.instrument), parts)


def _alarms(run: Run, stills: Mapping[int, bytes]) -> str:
    if run.time is None:
        return "<p>None: the frames are independent of each other.</p>"
    if not run.events:
        return "<p>None.</p>"
    blocks = [
        _event(i, event, stills.get(event.peak) if i <= MOST_STILLS else None) for i, event in enumerate(run.events, 1)
    ]
    plain = json.dumps(alarms(run.events)).replace("<", "\\u003c")
    return "".join(blocks) + _CONFIRM % plain


def _event(i: int, event: Event, still: bytes | None) -> str:
    interval = ""
    if event.alpha_low is not None and event.alpha_high is not None:
        interval = f" ({np.rad2deg(event.alpha_low):.2f} to {np.rad2deg(event.alpha_high):.2f})"
    told = (
        f"Alarm {i}: from {event.onset_s:.1f} s for {event.duration_s:.1f} s{', going on' if event.ongoing else ''}; "
        f"largest swing {np.rad2deg(event.alpha):.2f}°{interval} at {event.peak_s:.1f} s, "
        f"beyond 10° with probability {event.danger:.3f}"
    )
    choices = " ".join(
        f"<label><input type='radio' name='event-{i}' data-event='{i}' value='{value}'> {value}</label>"
        for value in ("true", "false", "unclear")
    )
    return (
        f"<p><strong>{html.text(told)}</strong><br>The operator says: {choices}</p>"
        + (html.photograph(still, f"Frame {event.peak}") if still is not None else "")
    )  # fmt: skip


def _largest(run: Run, stills: Mapping[int, bytes]) -> str:
    if not np.isfinite(run.alpha).any():
        return "<p>There is no angle.</p>"
    frame = int(np.nanargmax(run.alpha))
    caption = f"Frame {frame}: {np.rad2deg(run.alpha[frame]):.2f}°"
    return html.photograph(stills[frame], caption) if frame in stills else f"<p>{caption}</p>"


def _reasons(run: Run) -> str:
    """Count statuses and reasons; numbers within a reason are of one frame and left out."""
    counted: dict[tuple[str, str], int] = {}
    for m in run.measurements:
        if m.status != "ok":
            key = m.status, "".join("#" if c.isdigit() else c for c in m.reason)
            counted[key] = counted.get(key, 0) + 1
    if not counted:
        return "<p>None.</p>"
    body = [[*key, str(n)] for key, n in sorted(counted.items(), key=lambda item: -item[1])[:20]]
    return html.table(["", "reason", "frames"], body, {2})

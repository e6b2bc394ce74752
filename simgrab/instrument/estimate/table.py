"""The table of `simgrab estimate`."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from simgrab.instrument.estimate.measure import above
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate
from simgrab.reports.terminal import cell, stdout


def show(estimate: Estimate) -> None:
    """Print an estimate, or the reason of its refusal."""
    console = stdout()
    if not estimate.ok:
        console.print(cell(f"{estimate.estimator}: refused. {estimate.reason}"), soft_wrap=True)
        return
    assert estimate.beta is not None
    assert estimate.tilt_azimuth is not None
    assert estimate.sigma is not None
    assert estimate.alpha is not None
    table = Table(title=f"{estimate.estimator}, {estimate.frames} frames", title_justify="left")
    table.add_column("")
    table.add_column("estimate", justify="right")
    kinds = [i for i in estimate.intervals if i.sigma is not None]
    for interval in kinds:
        kind = f"{interval.blocks} blocks" if interval.blocks is not None else interval.kind
        table.add_column(f"{100 * interval.level:g} %, {kind}", justify="center")
    table.add_row("tilt β (deg)", f"{np.rad2deg(estimate.beta):.3f}", *(_ends(i.beta) for i in kinds))
    table.add_row("tilt azimuth (deg)", f"{np.rad2deg(estimate.tilt_azimuth):.2f}", *("" for _ in kinds))
    table.add_row("swing σ (deg)", f"{np.rad2deg(estimate.sigma):.3f}", *(_ends(i.sigma) for i in kinds))
    largest = int(np.nanargmax(estimate.alpha))
    of_largest = (_ends(None if i.alpha is None else i.alpha[largest]) for i in kinds)
    table.add_row("largest α (deg)", f"{np.rad2deg(estimate.alpha[largest]):.3f}", *of_largest)
    share, low, high = (None if one is None else f"{100 * one:.2f}" for one in above(estimate).values())
    reach = [f"{low} to {high}" if i.alpha is not None and low else "" for i in kinds[:1]]
    table.add_row("frames with α above 10° (%)", share, *reach, *("" for _ in kinds[1:]))
    if estimate.offset is not None:
        table.add_row("offset x, y, z (m)", ", ".join(f"{v:.3f}" for v in estimate.offset), *("" for _ in kinds))
    console.print(table)
    for interval in estimate.intervals:
        if interval.note:
            console.print(f"{interval.kind} intervals: {interval.note}", soft_wrap=True)


def _ends(ends: Array | None) -> str:
    return "" if ends is None else "{:.3f} to {:.3f}".format(*np.rad2deg(ends))

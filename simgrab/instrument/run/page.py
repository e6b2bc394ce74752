"""A run as one HTML page, with a step in which the operator confirms the alarms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simgrab.instrument.run import figures
from simgrab.instrument.run.runs import Run, alarms, reasons
from simgrab.instrument.run.table import HEAD, beside_paper, held
from simgrab.reports import html

MOST_STILLS = 40  # alarms that come with a picture


def page(run: Run, stills: Mapping[int, bytes], *, paper: bool = False) -> str:
    """Write the page; ``stills`` are annotated JPEGs by frame, ``paper`` whether the paper's figures stand beside."""
    return html.page(
        "run.html",
        run=run,
        stills=stills,
        most_stills=MOST_STILLS,
        figures=figures,
        facts=held(run),
        alarms=alarms(run.events),
        largest=int(np.nanargmax(run.alpha)) if np.isfinite(run.alpha).any() else None,
        head=HEAD,
        beside_paper=beside_paper(run) if paper else (),
        reasons=reasons(run.measurements),
    )

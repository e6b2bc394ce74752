"""The study as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple

import numpy as np

from simgrab.judge.paper.paper import PaperStudy
from simgrab.judge.paper.table import INCONSISTENT, rows
from simgrab.pages import html
from simgrab.pages.plots import Figure


def page(study: PaperStudy, figures: Mapping[str, Figure]) -> str:
    """Write the page; figures are inlined as SVG."""
    return html.page(
        "paper.html",
        settings=study.settings,
        figures=figures,
        estimators=_estimators(study),
        published=[astuple(row) for row in rows(study)],
        inconsistent=INCONSISTENT,
    )


def _estimators(study: PaperStudy) -> list[tuple[str, ...]]:
    named = (
        ("paper iteration, axis known", study.known),
        ("paper iteration, axis estimated", study.estimated),
        ("mean ray", study.mean_ray),
        ("geometric median", study.median),
    )
    return [
        (
            name,
            str(n),
            f"{np.rad2deg(spread.rmse_beta):.4f} ± {np.rad2deg(spread.standard_error):.4f}",
            f"{100 * spread.rmse_sigma2:.2f}",
            f"{spread.refused} of {spread.refused + len(spread.beta_error)}",
            f"{100 * spread.cover_beta:.1f}",
            f"{100 * spread.cover_sigma:.1f}",
        )
        for n in study.known
        for name, spreads in named
        for spread in (spreads[n],)
    ]

"""Run the paper's simulation study and write what it found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import astuple
from pathlib import Path

import numpy as np

from simgrab.errors import RunError
from simgrab.io.destination import check_folder
from simgrab.io.files import drafted, write
from simgrab.lab.paper import figures as paper_figures
from simgrab.lab.paper.paper import PaperSettings, PaperStudy, study
from simgrab.lab.paper.table import INCONSISTENT, rows
from simgrab.reports import html
from simgrab.reports.plots import Figure


def run(
    out: str | Path, settings: PaperSettings | None = None, tell: Callable[[str], None] = lambda _: None
) -> PaperStudy:
    """Run the study and write its figures (SVG and PNG) and ``paper.html`` into a folder.

    Parameters
    ----------
    out : path
        Folder, made if there is none.
    settings : PaperSettings, optional
    tell : callable
        Called with what is being done.

    Raises
    ------
    RunError
        If nothing can be written there.
    """
    folder = Path(out)
    check_folder(folder, RunError)
    found = study(settings or PaperSettings(), tell)
    tell("figures")
    figures = paper_figures.draw_all(found)
    for name, figure in figures.items():
        for ending in ("svg", "png"):
            with drafted(folder / f"{name}.{ending}") as draft:
                figure.savefig(draft, format=ending, dpi=130)
    write(folder / "paper.html", _page(found, figures))
    return found


def _page(study: PaperStudy, figures: Mapping[str, Figure]) -> str:
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

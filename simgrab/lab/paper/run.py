"""Run the paper's simulation study and write what it found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from simgrab.errors import RunError
from simgrab.io.destination import check_folder
from simgrab.io.files import drafted, write
from simgrab.lab.paper import figures as paper_figures
from simgrab.lab.paper.paper import PaperSettings, PaperStudy, study
from simgrab.lab.paper.table import INCONSISTENT, rows
from simgrab.reports import html


def run(
    out: str | Path, settings: PaperSettings | None = None, report: Callable[[str], None] = lambda _: None
) -> PaperStudy:
    """Run the study and write its figures (SVG and PNG) and ``paper.html`` into a folder, made if there is none.

    ``report`` is called with what is being done. Raises `RunError` if nothing can be written there.
    """
    folder = Path(out)
    check_folder(folder, RunError)
    found = study(settings or PaperSettings(), report)
    report("figures")
    figures = paper_figures.draw_all(found)
    for name, figure in figures.items():
        for ending in ("svg", "png"):
            with drafted(folder / f"{name}.{ending}") as draft:
                figure.savefig(draft, format=ending, dpi=130)
    page = html.page(
        "paper.html", settings=found.settings, figures=figures, estimators=_estimators(found), published=rows(found),
        inconsistent=INCONSISTENT,
    )  # fmt: skip
    write(folder / "paper.html", page)
    return found


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
            spread.beta_deg,
            f"{100 * spread.sigma2.rms:.2f}",
            f"{spread.refused} of {spread.refused + len(spread.beta_error)}",
            f"{100 * spread.cover_beta:.1f}",
            f"{100 * spread.cover_sigma:.1f}",
        )
        for n in study.known
        for name, spreads in named
        for spread in (spreads[n],)
    ]

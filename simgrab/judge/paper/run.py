"""Run the paper's simulation study and write what it found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from simgrab.errors import RunError
from simgrab.judge.paper import figures as paper_figures
from simgrab.judge.paper import page as paper_page
from simgrab.judge.paper.paper import PaperSettings, PaperStudy, study
from simgrab.utilities.destination import check_folder
from simgrab.utilities.files import drafted, write


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
    write(folder / "paper.html", paper_page.page(found, figures))
    return found

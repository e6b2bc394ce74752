"""The study as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simgrab.judge.paper.paper import PaperStudy, Spread
from simgrab.judge.paper.table import INCONSISTENT, rows
from simgrab.pages import html
from simgrab.pages.plots import Figure

_CAPTIONS = {
    "errors": ("Errors over n", "The paper's two error box plots: its settings, its rule, the 0-degree line known."),
    "convergence": ("Convergence", "Distance from the limit over the iterations, start 0, until the paper's rule stops "
                    "them. The boxes are narrow because all replications take nearly the same path; differences below "
                    "1e-14 are rounding, and drawn there."),
    "starts": ("Start values", "Up to about twice the tilt every start ends at the same value. Above it (est-3) asks "
               "for the arccosine of more than 1, and the record is refused."),
    "rivals": ("With the axis estimated", "Estimating the 0-degree line costs β next to nothing. Under the paper's own "
               "law the geometric median needs a fraction of the frames."),
}  # fmt: skip


def page(study: PaperStudy, figures: Mapping[str, Figure]) -> str:
    """Write the page; figures are inlined as SVG."""
    s = study.settings
    lead = (
        f"h = {s.h:g} px, β = {np.rad2deg(s.beta):g}°, σ = {np.rad2deg(s.sigma):g}°, {s.replications} replications, "
        f"seed {s.seed}."
    )
    return html.page(
        "The paper's simulation study, run again",
        "Yu, Wang &amp; Wang, “A Geometric Model with Stochastic Error for Abnormal Motion Detection "
        f"of Portal Crane Bucket Grab”, section 4.4. {html.text(lead)}",
        [
            *(html.section(title, html.drawing(figures[name], name, caption))
              for name, (title, caption) in _CAPTIONS.items()),
            html.section("Estimators on the same draws", _estimators(study)),
            html.section("Published beside measured", _published(study)),
            html.section("Where the text does not agree with itself", _inconsistent()),
        ],
    )  # fmt: skip


def _estimators(study: PaperStudy) -> str:
    def cells(name: str, n: int, spread: Spread) -> list[str]:
        total = spread.refused + len(spread.beta_error)
        return [
            name,
            str(n),
            f"{np.rad2deg(spread.rmse_beta):.4f} ± {np.rad2deg(spread.standard_error):.4f}",
            f"{100 * spread.rmse_sigma2:.2f}",
            f"{spread.refused} of {total}",
            f"{100 * spread.cover_beta:.1f}",
            f"{100 * spread.cover_sigma:.1f}",
        ]

    named = (
        ("paper iteration, axis known", study.known),
        ("paper iteration, axis estimated", study.estimated),
        ("mean ray", study.mean_ray),
        ("geometric median", study.median),
    )
    body = [cells(name, n, spread) for n in study.known for name, spreads in named for spread in (spreads[n],)]
    head = ["estimator", "n", "RMSE of β̂ (deg)", "RMSE of σ̂² (%)", "refused", "95 % of β (%)", "95 % of σ (%)"]
    return html.table(head, body, {1, 2, 3, 4, 5, 6})


def _published(study: PaperStudy) -> str:
    body = [[r.section, r.quantity, r.published, r.measured, r.note] for r in rows(study)]
    return html.table(["section", "", "published", "measured", ""], body, set())


def _inconsistent() -> str:
    return html.table(["section", ""], [list(pair) for pair in INCONSISTENT], set())

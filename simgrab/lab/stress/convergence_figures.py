"""The map of where the paper's iteration converges, to what, and how fast."""

from __future__ import annotations

import numpy as np

from simgrab.lab.stress.convergence import population, starts_at_zero
from simgrab.lab.stress.figures import COLOURS
from simgrab.lab.stress.laws import KURTOSIS
from simgrab.lab.stress.parameters import Value
from simgrab.lab.stress.summary import Summary
from simgrab.model.geometry import Array
from simgrab.reports.plots import Axes, Figure, rc_context


def values(summary: Summary, axis: str) -> tuple[Value, ...]:
    """Values of one axis of the map."""
    return next(s.values for s in summary.study.axes if s.axis == axis)


def grid(summary: Summary, law: Value, n: Value, column: str) -> Array:
    """Means of a column, shape (β, σ)."""
    name = summary.study.estimators[0]
    return np.array(
        [
            [summary.at((law, n, b, s), name, column).mean for s in values(summary, "sigma")]
            for b in values(summary, "beta")
        ]
    )


def draw(summary: Summary) -> Figure:
    """Draw share converged from start 0 for each distribution, at the largest n, and three curves."""
    laws, ns = values(summary, "alpha-law"), values(summary, "n")
    with rc_context({"font.size": 8.5, "svg.fonttype": "none", "axes.titlesize": 9.5}):
        figure = Figure(figsize=(11.5, 6.6), layout="constrained")
        above, below = np.ravel(np.asarray(figure.subfigures(2, 1)))
        maps = np.atleast_1d(above.subplots(1, len(laws), sharey=True))
        for axes, law in zip(maps, laws, strict=True):
            _map(axes, summary, law, ns[-1])
        maps[0].set_ylabel("β (deg)")
        above.suptitle(f"converged from start 0 (%), n = {ns[-1]:g}; *: predicted to leave its domain for n → ∞")
        rates, where, steps = below.subplots(1, 3)
        _rates(rates, summary)
        _fixed(where, summary)
        _steps(steps, summary)
        return figure


def _map(axes: Axes, summary: Summary, law: Value, n: Value) -> None:
    beta, sigma = (np.array(values(summary, a), float) for a in ("beta", "sigma"))
    share = 100 * grid(summary, law, n, "converges")
    axes.imshow(share, origin="lower", aspect="auto", cmap="RdYlGn", vmin=0, vmax=100, alpha=0.75)
    for (i, j), v in np.ndenumerate(share):
        foretold = starts_at_zero(np.deg2rad(beta[i]), np.deg2rad(sigma[j]), KURTOSIS[str(law)])
        axes.text(j, i, f"{v:.0f}" + ("" if foretold else "*"), ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(sigma)), [f"{s:g}" for s in sigma])
    axes.set_yticks(range(len(beta)), [f"{b:g}" for b in beta])
    axes.set(title=str(law), xlabel="σ (deg)")


def _rates(axes: Axes, summary: Summary) -> None:
    n, name = values(summary, "n")[-1], summary.study.estimators[0]
    for law, colour in zip(values(summary, "alpha-law"), COLOURS, strict=False):
        points = [p for p in summary.study.points if p[0] == law and p[1] == n]
        pairs = [(summary.at(p, name, "rate_linear").mean, summary.at(p, name, "rate").mean) for p in points]
        axes.plot(*np.array(pairs).T, ".", color=colour, ms=5, label=str(law))
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], color="#8a8f94", lw=0.8)
    axes.set(title="contraction: measured against linearised", xlabel="cotβ*·mean(x·α/sinα)", ylabel="T′(β*)")
    axes.legend(fontsize=7)


def _fixed(axes: Axes, summary: Summary) -> None:
    n, sigma = values(summary, "n")[-1], values(summary, "sigma")[-1]
    name = summary.study.estimators[0]
    for law, colour in zip(values(summary, "alpha-law"), COLOURS, strict=False):
        beta = np.array(values(summary, "beta"), float)
        found = [summary.at((law, n, b, sigma), name, "fixed_error_deg").statistic("mean") for b in beta]
        value, error = np.array(found).T
        axes.errorbar(beta, value, yerr=error, fmt="o", ms=3, color=colour, capsize=2)
        fine = np.linspace(beta.min(), beta.max(), 200)
        foretold = [population(np.deg2rad(b), np.deg2rad(float(sigma)), KURTOSIS[str(law)])[0] for b in fine]
        axes.plot(fine, np.rad2deg(foretold) - fine, color=colour, lw=1)
    axes.set(title=f"β* − β at σ = {sigma:g}°; lines: theory, n → ∞", xlabel="β (deg)", ylabel="deg")
    axes.grid(lw=0.4, alpha=0.6)


def _steps(axes: Axes, summary: Summary) -> None:
    n, name = values(summary, "n")[-1], summary.study.estimators[0]
    sigma = values(summary, "sigma")[len(values(summary, "sigma")) // 2]
    for law, colour in zip(values(summary, "alpha-law"), COLOURS, strict=False):
        beta = values(summary, "beta")
        axes.plot(
            np.array(beta, float), [summary.at((law, n, b, sigma), name, "iterations").mean for b in beta],
            "o-", ms=3, lw=1.2, color=colour,
        )  # fmt: skip
    axes.set(title=f"steps from start 0 at σ = {sigma:g}°", xlabel="β (deg)", ylabel="mean iterations")
    axes.grid(lw=0.4, alpha=0.6)


def sentences(summary: Summary) -> list[str]:
    """Say what the map shows, from its numbers."""
    laws, n = values(summary, "alpha-law"), values(summary, "n")[-1]
    name = summary.study.estimators[0]
    here = [p for p in summary.study.points if p[1] == n]
    result = []
    for law in laws:
        share = grid(summary, law, n, "converges")
        repaired = grid(summary, law, n, "repaired")
        result.append(
            f"{law}: start 0 converges in all records at {np.sum(share == 1)} of {share.size} pairs of β and σ and in "
            f"none at {np.sum(share == 0)}; from the mean ray in all at {np.sum(repaired == 1)}."
        )
    gaps = [
        abs(summary.at(p, name, "rate").mean - summary.at(p, name, "rate_linear").mean)
        for p in here
        if summary.at(p, name, "rate").count
    ]
    sizes = [abs(summary.at(p, name, "rate").mean) for p in here if summary.at(p, name, "rate").count]
    if gaps:
        result.append(
            f"The contraction measured and that of the linearisation differ by {max(gaps):.1e} at most (median "
            f"{float(np.median(gaps)):.1e}); its size is below {np.median(sizes):.1e} at half of the points."
        )
    apart = [summary.at(p, name, "apart_deg") for p in here]
    furthest = max((f.mean for f in apart if f.count), default=np.nan)
    result.append(f"Where both starts converge, they end within {furthest:.1e}° of each other.")
    domain = [(summary.at(p, name, "domain").mean, summary.at(p, name, "foretold").mean) for p in here]
    agree = np.mean([abs(a - b) < 0.5 for a, b in domain])
    result.append(
        f"The kurtosis of the rays predicts whether start 0 stays in its domain at {100 * agree:.0f} % of the points."
    )
    return result

"""Print the Monte Carlo tables of the estimators, with their standard errors.

    uv run scripts/estimators.py [rivals|offsets|smoother|intervals] [--records M]

`simgrab paper` prints the study of the paper itself.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

# The studies are the tests' own, simulator included: these tables are the tests run at full size.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "instrument"))
import studies  # type: ignore[import-not-found]


def _percent(value: float) -> str:
    return "      –" if np.isnan(value) else f"{100 * value:6.1f} %"


def rivals(records: int) -> None:
    """Which estimator is best where, frames independent, camera at the rope exit."""
    print(f"\nRMSE of β̂ (deg) ± Monte Carlo standard error; σ = 2°, M = {records}; refused records are counted apart")
    for law in studies.LAWS:
        for beta in (5.0, 1.0):
            for frames in (100, 1000):
                scores = studies.rivals(law, records, frames, beta)
                best = studies.best({k: s for k, s in scores.items() if k != "paper, axis known"})
                print(f"\n{law}, β = {beta:g}°, n = {frames}: best without knowing the axis, {', '.join(best)}")
                for name, s in scores.items():
                    ahead = studies.beats(s, scores["mean-ray"]) if name != "mean-ray" else float("nan")
                    versus = "" if np.isnan(ahead) else f"   ahead of mean ray by {ahead:+6.1f} standard errors"
                    print(f"  {name:22s} {s.rmse:8.4f} ± {s.error:.4f}   refused {_percent(s.refused)}{versus}")


def offsets(records: int) -> None:
    """Camera beside the rope exit."""
    print(f"\nRMSE (deg) with the camera beside the rope; β = 5°, σ = 2°, n = 3,699, ropes of 8 to 35 m, M = {records}")
    for law in ("half-normal", "rayleigh"):
        for offset in (0.3, 0.8, 1.5):
            print(f"\n{law}, offset {offset} m")
            for name, s in studies.offsets(law, offset, records).items():
                print(
                    f"  {name:18s} β̂ {s.rmse:7.4f} ± {s.error:.4f}   α̂ {s.alpha:7.4f}   refused {_percent(s.refused)}"
                )
    print("\nOffsets drawn from the prior, 0 ± 0.5 m per axis")
    for rope in ((28.0, 33.0), (8.0, 35.0)):
        for law in ("half-normal", "rayleigh"):
            mean, aware, cover = studies.drawn_offsets(law, rope, records)
            print(
                f"  {law:12s} ropes {rope[0]:g}–{rope[1]:g} m: β̂ mean-ray {mean.rmse:.4f}, rope-aware {aware.rmse:.4f} "
                f"± {aware.error:.4f}; 95 % of β {_percent(cover[0])}, σ {_percent(cover[1])}, α {_percent(cover[2])}"
            )


def smoother(records: int) -> None:
    """Free and forced pendulums."""
    print(
        "\nPendulum records; offset 0.6 m ± 5 cm, noise 1 px, 10 % missing, 2 % outliers, rope 16–24 m; RMSE of β̂ (deg)"
    )
    cases: list[tuple[str, str, float, dict[str, Any], int]] = [
        ("free, 15 s, α 3° rms, 0.5 % damping", "free", 15.0, {"damping": 0.005, "size_deg": 3.0}, records),
        ("free, 15 s, α 5° rms, 0.5 % damping", "free", 15.0, {"damping": 0.005, "size_deg": 5.0}, records),
        ("free, 15 s, α 2° rms, 1 % damping", "free", 15.0, {}, records),
        ("forced, 120 s", "forced", 120.0, {}, max(records // 3, 10)),
        ("forced, 300 s", "forced", 300.0, {}, max(records // 3, 10)),
        ("forced, 900 s, 0.3 % damping", "forced", 900.0, {"damping": 0.003}, max(records // 10, 10)),
        ("forced with wandering lean 0.5°, 300 s", "forced", 300.0, {"slow_deg": 0.5}, max(records // 3, 10)),
    ]
    for title, kind, seconds, options, many in cases:
        s = studies.swinging(kind, many, seconds, **options)
        others = ", ".join(f"{name} {rmse:.4f}" for name, rmse in s.others.items())
        print(
            f"  {title}, M = {many}\n    smoother {s.rmse:.4f} ± {s.error:.4f} (α̂ {s.alpha:.4f}), 95 % of β "
            f"{_percent(s.beta_cover)}, of α {_percent(s.alpha_cover)}, refused {_percent(s.refused)}; {others}",
            flush=True,
        )


def intervals(records: int) -> None:
    """Coverage of nominal 95 % intervals."""
    print(f"\nCoverage of nominal 95 % intervals of β, σ and α; independent frames, M = {5 * records}")
    for law in studies.LAWS:
        for frames in (100, 1000):
            for name, cover in studies.independent(law, 5 * records, frames).items():
                print(f"  {law:12s} n = {frames:5d}  {name:18s} {' '.join(map(_percent, cover))}")
    print(f"\nForced pendulum records, 20 m rope, σ = 2°, M = {2 * records}")
    for minutes in (30.0, 60.0, 120.0):
        for damping in (0.01, 0.005):
            for name, kinds in studies.long_records(2 * records, minutes, damping).items():
                text = "   ".join(f"{kind} {' '.join(map(_percent, cover))}" for kind, cover in kinds.items())
                print(f"  {minutes:5.0f} min, {100 * damping:g} % damping  {name:18s} {text}", flush=True)


TABLES = {"rivals": rivals, "offsets": offsets, "smoother": smoother, "intervals": intervals}


@click.command()
@click.argument("table", type=click.Choice([*TABLES, "all"]), default="all")
@click.option("--records", type=click.IntRange(min=10), default=200, show_default=True, help="M.")
def main(table: str, records: int) -> None:
    """Print one table or all."""
    for name in TABLES if table == "all" else [table]:
        TABLES[name](records)


if __name__ == "__main__":
    main()

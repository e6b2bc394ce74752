"""Compare what a dataset, or a scene, drew with what its scenario asked for.

``python -m scripts.factors DATASET_OR_SCENE [--frames N]`` prints, for each factor and each distribution of frames,
a p-value: chi-square for choices, Kolmogorov-Smirnov for continuous ones. It warns of gaps: values never drawn, and
empty tenths of a range. A dataset's boxes and hidden shares, for which nothing was asked, are printed as tenths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy import stats

from simgrab.errors import DatasetError
from simgrab.io import parquet
from simgrab.model import scenes
from simgrab.model.distributions import Choice, Constant, Distribution
from simgrab.model.geometry import Array
from simgrab.model.scenario import Factor, Iid, OneOf, Scenario, Variant, variants
from simgrab.world.trajectory import iid as swing
from simgrab.world.trajectory.moment import Moment

ALARM = 0.001  # a draw so rare should be inspected
DRAWN = 250_000  # of a distribution, to sample its distribution function
DRAWS_FOR_TENTHS = 60  # with fewer, an empty tenth is not significant
COLUMNS = (
    "box_centre_x", "box_centre_y", "box_width", "box_height", "box_area", "alpha_deg", "rope_length_m",
    "visible_fraction", "in_frame_fraction", "weather_hidden_fraction",
)  # fmt: skip


@dataclass(frozen=True)
class Line:
    """One row of the report: what, how often drawn, p-value of a distribution, tenths or counts, and warnings."""

    name: str
    count: int
    p: float | None
    shape: str
    warnings: tuple[str, ...] = ()


def factor(name: str, asked: Factor, drawn: Sequence[Any]) -> Line:
    """Compare a factor's draws with its distribution."""
    if isinstance(asked, OneOf):
        called = [str(asked.called(i)) for i in range(len(asked.values))]
        return _choice(name, called, asked.probabilities, [str(value) for value in drawn])
    return law(name, [asked] * len(drawn), drawn)


def law(name: str, asked: Sequence[Distribution], drawn: Sequence[float]) -> Line:
    """Compare draws with distributions, one for each: its distribution function makes each draw uniform."""
    first = asked[0]
    if isinstance(first, Choice | Constant):
        choice = Choice((first.value,)) if isinstance(first, Constant) else first
        weights: dict[float, float] = {}
        for value, weight in zip(choice.values, choice.weights or (1.0,) * len(choice.values), strict=True):
            weights[value] = weights.get(value, 0.0) + weight
        shares = [w / sum(weights.values()) for w in weights.values()]
        return _choice(name, [f"{v:g}" for v in weights], shares, [f"{v:g}" for v in drawn])
    functions = {one: _distribution(one) for one in set(asked)}
    uniform = np.array([functions[one](value) for one, value in zip(asked, drawn, strict=True)])
    p = float(stats.kstest(uniform, "uniform").pvalue)
    return _judged(name, p, _tenths(uniform, 0.0, 1.0), len(drawn), f"{min(drawn):.4g} … {max(drawn):.4g}")


def spread(name: str, values: Array) -> Line:
    """Tenths of a column for which nothing was asked."""
    counts = _tenths(values, float(values.min()), float(values.max()))
    shape = f"{values.min():.4g} … {values.max():.4g}  {' '.join(map(str, counts))}"
    return Line(name, len(values), None, shape)


def _judged(name: str, p: float, tenths: Sequence[int], count: int, span: str) -> Line:
    warnings = [f"p = {p:.1e}: not the law asked for"] if p < ALARM else []
    if count >= DRAWS_FOR_TENTHS and 0 in tenths:
        empty = ", ".join(f"{10 * i}-{10 * i + 10} %" for i, n in enumerate(tenths) if n == 0)
        warnings.append(f"gap: nothing between the law's quantiles {empty}")
    return Line(name, count, p, f"{span}  {' '.join(map(str, tenths))}", tuple(warnings))


def _choice(name: str, called: Sequence[str], shares: Sequence[float], drawn: Sequence[str]) -> Line:
    counts = Counter(drawn)
    possible = [(c, s) for c, s in zip(called, shares, strict=True) if s > 0]
    observed, expected = [counts[c] for c, _ in possible], [s * len(drawn) for _, s in possible]
    warnings = [f"{value!r} was drawn and never asked for" for value in sorted(set(counts) - {c for c, _ in possible})]
    p = float(stats.chisquare(observed, expected).pvalue) if len(possible) > 1 and not warnings else 1.0
    warnings += [f"p = {p:.1e}: not the shares asked for"] if p < ALARM else []
    warnings += [
        f"gap: never {value!r}"
        for (value, _), n, e in zip(possible, observed, expected, strict=True)
        if n == 0 and e >= 1
    ]
    shape = "  ".join(f"{c} {n}/{e:.0f}" for (c, _), n, e in zip(possible, observed, expected, strict=True))
    return Line(name, len(drawn), p, shape, tuple(warnings))


def _tenths(values: Array, low: float, high: float) -> list[int]:
    return [int(n) for n in np.histogram(values, 10, (low, high if high > low else low + 1))[0]]


def _distribution(one: Distribution) -> Callable[[float], float]:
    drawn = np.sort(np.asarray(one.sample(np.random.default_rng(0), DRAWN), float))
    return lambda value: float(np.searchsorted(drawn, value)) / DRAWN


def report(scenario: Scenario, table: Mapping[str, Array] | None = None) -> list[Line]:
    """Compare a scenario's draws with its distributions, and report a dataset's boxes where there is one."""
    every = list(variants(scenario))
    lines = []
    for key, asked in sorted(scenario.vary.items()):
        drawn = [one.drawn[key] for one, _ in every if key in one.drawn]  # not where the kind drawn has no such key
        lines += [factor(key, asked, drawn)] if drawn else []
    if isinstance(scenario.swing, Iid):
        lines += _swings([(one, swing.draw(one.scenario, frame)) for one, span in every for frame in span])
    if table:
        lines += [spread(name, table[name]) for name in COLUMNS]
    return lines


def _swings(drawn: Sequence[tuple[Variant, Moment]]) -> list[Line]:
    """Compare frames' draws with the distributions of their variants' swing."""
    lines = []
    for name, value in (
        ("rope_length_m", lambda m: m.grab.rope_length),
        ("gamma_deg", lambda m: np.degrees(m.gamma)),
        ("yaw_deg", lambda m: np.degrees(m.grab.yaw)),
        ("jaw_deg", lambda m: round(float(np.degrees(m.grab.jaw)), 9)),
    ):
        laws = [getattr(_iid(one), name) for one, _ in drawn]
        lines.append(law(f"swing.{name}", laws, [float(value(moment)) for _, moment in drawn]))
    unscaled = [
        float(np.degrees(m.grab.alpha)) / _iid(one).alpha.scale_deg if _iid(one).alpha.scale_deg else 0.0
        for one, m in drawn
    ]
    lines.append(law("swing.alpha, in units of its law", [_iid(one).alpha.law for one, _ in drawn], unscaled))
    absent = _iid(drawn[0][0]).absent
    there = [str(m.present) for _, m in drawn]
    lines.append(_choice("present", ["True", "False"], [1 - absent, absent], there))
    return lines


def _iid(one: Variant) -> Iid:
    assert isinstance(one.scenario.swing, Iid)
    return one.scenario.swing


def _columns(path: Path) -> dict[str, Array]:
    """Columns of a dataset's rows that have a box."""
    table = (
        parquet.read_table(path / "labels.parquet", DatasetError)
        .to_pandas(use_threads=False)
        .dropna(subset=["box_x0_px"])
    )
    x0, y0, x1, y1 = (table[f"box_{c}_px"] / table[s] for c, s in (
        ("x0", "width_px"), ("y0", "height_px"), ("x1", "width_px"), ("y1", "height_px")))  # fmt: skip
    table = table.assign(
        box_centre_x=(x0 + x1) / 2, box_centre_y=(y0 + y1) / 2, box_width=x1 - x0, box_height=y1 - y0,
        box_area=(x1 - x0) * (y1 - y0),
    )  # fmt: skip
    return {name: table[name].to_numpy(float) for name in COLUMNS}


@click.command()
@click.argument("source")
@click.option("--frames", type=int, help="Of a scene: so many frames instead of its own number.")
def main(source: str, frames: int | None) -> None:
    """Print the distribution of every factor of SOURCE, a dataset's folder or a scene, against what was asked."""
    path = Path(source)
    known = path / "manifest.json"
    scenario = scenes.load(known if known.is_file() else source, {"frames": frames} if frames else None)
    lines = report(scenario, _columns(path) if known.is_file() else None)
    for line in lines:
        p = "      " if line.p is None else f"p {line.p:.2f}"
        click.echo(f"{p}  n {line.count:<6d} {line.name}: {line.shape}")
    warnings = [f"warning: {line.name}: {warning}" for line in lines for warning in line.warnings]
    click.echo("\n".join(["", *warnings] if warnings else ["", "no gaps"]))


if __name__ == "__main__":
    main()

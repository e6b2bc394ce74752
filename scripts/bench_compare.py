"""Compare two files of results: ratio of medians, with its spread, quantity by quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from scripts.bench_results import Quantity, Results, ResultsError
from simgrab.model.rng import stream

RESAMPLES = 2000


def compare(a: Results, b: Results) -> Iterator[str]:
    """Yield lines: in what the runs differ, then each quantity's medians and the ratio of B's to A's.

    The interval is a percentile bootstrap: it holds 95 % of the ratios of medians when each run's samples are drawn
    again with replacement. It covers the spread within two runs, and not how much further runs would differ.

    Raises
    ------
    ResultsError
        If the runs share no quantity, or name one in different units.
    """
    theirs = {quantity.name: quantity for quantity in b.quantities}
    pairs = [(quantity, theirs[quantity.name]) for quantity in a.quantities if quantity.name in theirs]
    if not pairs:
        raise ResultsError(f"nothing to compare: A holds quantities of {a.verb!r}, B of {b.verb!r}")
    for name, results in (("A", a), ("B", b)):
        yield f"{name}: {results.verb} at {results.commit[:7] + results.commit[40:]}, {results.date}"
    yield from _differences(a, b, pairs)
    width = max(len(one.name) for one, _ in pairs)
    yield f"{'':{width}s} {'A':>10s} {'B':>10s}  B / A (95 %)"
    for one, other in pairs:
        if one.unit != other.unit:
            raise ResultsError(f"{one.name!r} is in {one.unit} in A and in {other.unit} in B")
        yield f"{one.name:{width}s} {one.median:10.4g} {other.median:10.4g}  {_shown(one, other)}  {one.unit}"
    for name, results in (("A", a), ("B", b)):
        alone = [
            quantity.name for quantity in results.quantities if quantity.name not in {one.name for one, _ in pairs}
        ]
        if alone:
            yield f"only in {name}: {', '.join(alone)}"


def _differences(a: Results, b: Results, pairs: list[tuple[Quantity, Quantity]]) -> Iterator[str]:
    kinds: list[tuple[str, Mapping[str, Any], Mapping[str, Any]]] = [
        ("machines", a.machine, b.machine),
        ("versions", a.versions, b.versions),
        ("options", a.options, b.options),
        ("programs", {one.name: one.by for one, _ in pairs}, {other.name: other.by for _, other in pairs}),
    ]
    for kind, ours, theirs in kinds:
        for key in sorted(ours.keys() | theirs.keys()):
            if ours.get(key) != theirs.get(key):
                yield f"different {kind}: {key}: {ours.get(key, 'absent')} in A, {theirs.get(key, 'absent')} in B"


def ratio(one: Quantity, other: Quantity) -> tuple[float, float, float]:
    """Return the other's median over one's, and the ends of its interval; all samples must be positive."""
    rng = stream(0, 0, "bench compare")
    below, above = (
        np.median(rng.choice(quantity.samples, (RESAMPLES, len(quantity.samples))), axis=1) for quantity in (one, other)
    )
    low, high = np.percentile(above / below, [2.5, 97.5])
    return other.median / one.median, float(low), float(high)


def _shown(one: Quantity, other: Quantity) -> str:
    if min(*one.samples, *other.samples) <= 0:
        return "no ratio: samples of 0 or less"
    middle, low, high = ratio(one, other)
    counts = len(one.samples), len(other.samples)
    if 1 in counts:
        return f"{middle:.3f} (no spread: one sample)"
    return f"{middle:.3f} ({low:.3f}–{high:.3f}; n = {counts[0]} and {counts[1]})"

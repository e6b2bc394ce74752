"""Compare two files of results: ratio of medians, with its spread, quantity by quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from scripts.bench_results import Quantity, Results, ResultsError
from simgrab.rng import stream

RESAMPLES = 2000


def compare(a: Results, b: Results) -> Iterator[str]:
    """Yield lines: in what the runs differ, then each quantity's medians and the ratio of B's to A's.

    The interval holds 95 % of the ratios of medians of samples that are drawn again, with replacement, from each run
    by itself (percentile bootstrap). It states how well two runs are known, and not how much other runs would differ.

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
        yield f"{one.name:{width}s} {one.median:10.4g} {other.median:10.4g}  {_ratio(one, other)}  {one.unit}"
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


def _ratio(one: Quantity, other: Quantity) -> str:
    if min(*one.samples, *other.samples) <= 0:
        return "no ratio: samples of 0 or less"
    text = f"{other.median / one.median:.3f}"
    if len(one.samples) == 1 or len(other.samples) == 1:
        return f"{text} (no spread: one sample)"
    rng = stream(0, 0, "bench compare")
    drawn = [
        np.median(rng.choice(quantity.samples, (RESAMPLES, len(quantity.samples))), axis=1) for quantity in (one, other)
    ]
    low, high = np.percentile(drawn[1] / drawn[0], [2.5, 97.5])
    return f"{text} ({low:.3f}–{high:.3f}; n = {len(one.samples)} and {len(other.samples)})"

"""What the benchmarks share: acts that are timed in turns, and memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from scripts.bench_results import Quantity

T = TypeVar("T")


def in_turns(
    acts: Mapping[str, Callable[[T], Any]], items: Iterable[T], warm_up: int, most: Mapping[str, int] | None = None
) -> dict[str, list[float]]:
    """Time all acts on one item, then on the next, so that what slows the machine slows them alike.

    Parameters
    ----------
    acts : mapping of str to callable
        By name; each is called with an item.
    items : iterable
    warm_up : int
        The first so many items are not timed.
    most : mapping of str to int, optional
        Acts that are only called for so many of the timed items.

    Returns
    -------
    dict of str to list of float
        Seconds.
    """
    took: dict[str, list[float]] = {name: [] for name in acts}
    for number, item in enumerate(items):
        for name, act in acts.items():
            if most and name in most and not 0 <= number - warm_up < most[name]:
                continue
            start = time.perf_counter()
            act(item)
            if number >= warm_up:
                took[name].append(time.perf_counter() - start)
    return took


def milliseconds(name: str, seconds: Iterable[float], by: str = "") -> Quantity:
    """Make a quantity of seconds."""
    return Quantity(name, "ms", tuple(float(1e3 * s) for s in seconds), by)


def single(name: str, value: float, unit: str) -> Quantity:
    """Make a quantity of one sample."""
    return Quantity(name, unit, (float(value),))


def ratios(name: str, above: Iterable[float], below: Iterable[float]) -> Quantity:
    """Make a quantity of ratios, pair by pair as far as there are pairs."""
    return Quantity(name, "×", tuple(float(a / b) for a, b in zip(above, below, strict=False)))


def resident_mb() -> float:
    """Memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def peak_mb(who: int = resource.RUSAGE_SELF) -> float:
    """Return the most memory that this process had, or with ``RUSAGE_CHILDREN`` the largest child that has ended."""
    return resource.getrusage(who).ru_maxrss * 1.024e-3

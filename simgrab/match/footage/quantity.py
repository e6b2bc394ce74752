"""A quantity with its interval, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """What footage determines of one quantity."""

    value: float | None  # None where the footage does not determine it
    # low, high: ends of the 95 % interval; infinite where there is none
    low: float = -math.inf
    high: float = math.inf
    reason: str = ""  # why it is not determined; empty where it is
    unit: str = ""  # as reports write it; empty for none

    def __post_init__(self) -> None:
        if (self.value is None) != bool(self.reason):
            raise ValueError("a quantity has either a value or the reason why it has none")
        if self.value is not None and not self.low <= self.value <= self.high:
            raise ValueError(f"{self.value:g} lies outside its interval, {self.low:g} to {self.high:g}")

    @property
    def known(self) -> bool:
        """Whether the footage determines it."""
        return self.value is not None

    def text(self) -> str:
        """Write value and interval, or the reason."""
        if self.value is None:
            return f"not determined by this footage: {self.reason}"
        unit = f" {self.unit}" if self.unit else ""
        if self.low == self.high:
            return f"{self.value:.4g}{unit}"
        return f"{self.value:.4g}{unit} ({self.low:.4g} to {self.high:.4g})"


def exact(value: float, unit: str = "") -> Quantity:
    """Give a quantity that the file states."""
    return Quantity(value, value, value, unit=unit)


def positive(value: float, reach: float, unit: str = "") -> Quantity:
    """Give a quantity that is not below 0, and how far its interval reaches on both sides."""
    return Quantity(value, max(value - reach, 0.0), value + reach, unit=unit)


def unknown(reason: str, unit: str = "") -> Quantity:
    """Give a quantity that the footage does not determine."""
    return Quantity(None, reason=reason, unit=unit)

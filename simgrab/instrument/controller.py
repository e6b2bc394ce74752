"""What the crane's controller reports of its own motion."""

from __future__ import annotations

from dataclasses import dataclass

from simgrab.model.geometry import Array


@dataclass(frozen=True, eq=False)
class Controller:
    r"""Readings of slew angle, radius and rope length.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, increasing, on the clock of the pictures, with the controller's lag removed.
    slew : ndarray, shape (n,), or None
        rad, unwrapped, counter-clockwise from above.
    radius : ndarray, shape (n,), or None
        Slewing axis to O, m.
    rope : ndarray, shape (n,), or None
        \|OA\|, m.
    slew_sd, radius_sd, rope_sd : float
        Standard deviation of one reading.
    """

    time: Array
    slew: Array | None
    radius: Array | None
    rope: Array | None
    slew_sd: float
    radius_sd: float
    rope_sd: float

"""Transverse waves of the ropes, as string modes between O and the rope ends, which the grab does not feel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.trajectory.clip import Block, ClipMotion
from simgrab.world.trajectory.noise import low_pass

KG_M_MM2 = 0.0041
"""Mass of a metre of rope over its diameter squared: six strands about a steel core."""
_LEAST_PULL = 0.1
"""Of the weight, m/s² a kilogram: what a tension stays above, where a grab falls as fast as gravity has it."""


@dataclass(frozen=True, eq=False)
class WaveAmplitudes:
    """Amplitudes of the modes at n instants, of horizontal displacement in the pivot frame of `Motion`.

    At a distance s from O the ropes are displaced by Σ amplitude · sin(number · π s/length).
    """

    amplitude: Array  # (n, modes, 2), m
    rate: Array  # (n, modes, 2)
    acceleration: Array  # (n, modes, 2)
    length: Array  # (n,), from O to the rope ends, m
    length_rate: Array  # (n,)
    length_acceleration: Array  # (n,)

    def __getitem__(self, which: NDArray[np.intp]) -> WaveAmplitudes:
        return WaveAmplitudes(**{name: values[which] for name, values in vars(self).items()})

    def at(self, distance: float) -> tuple[Array, Array, Array]:
        """Motion of the ropes at a distance from O, m, shape (n, 3) each.

        Returns
        -------
        acceleration : ndarray
            m/s².
        slope, slope_rate : ndarray
            Derivative of the displacement by the distance, and its rate, 1/s.
        """
        number = np.arange(1, self.amplitude.shape[1] + 1)
        k = number * np.pi / self.length[:, None]
        shrinking = (self.length_rate / self.length)[:, None]
        k_rate = -k * shrinking
        k_acceleration = k * (2 * shrinking**2 - (self.length_acceleration / self.length)[:, None])
        sin, cos = np.sin(k * distance), np.cos(k * distance)
        shape = np.stack([sin, distance * k_rate * cos,
                          distance * k_acceleration * cos - (distance * k_rate) ** 2 * sin])  # fmt: skip
        slope = np.stack([k * cos, k_rate * cos - k * distance * k_rate * sin])

        def total(*terms: tuple[Array, Array]) -> Array:
            flat = sum(np.einsum("nm,nmi->ni", weight, values) for weight, values in terms)
            return np.column_stack([flat, np.zeros(len(k))])

        return (
            total((shape[0], self.acceleration), (2 * shape[1], self.rate), (shape[2], self.amplitude)),
            total((slope[0], self.amplitude)),
            total((slope[0], self.rate), (slope[1], self.amplitude)),
        )


class Strings:
    """The modes of a clip's ropes, from interval to interval, during which what acts on them is constant.

    A load w(s) across the ropes, m/s², drives mode j, of frequency ω = (jπ/l)·√(tension/mass a metre), by
    (2/l)·∫ w sin(jπs/l) ds. The load is apparent gravity less the acceleration of the straight rope, and what shakes
    the exits. It begins in its steady state.

    Parameters
    ----------
    modes : int
    damping : float
        Share of the critical one.
    kg_m : float
        Mass of a metre of all ropes.
    """

    def __init__(self, modes: int, damping: float, kg_m: float) -> None:
        self._number, self._damping, self._kg_m = np.arange(1, modes + 1)[:, None], damping, kg_m
        self._state: tuple[Array, Array] | None = None

    def step(
        self, seconds: float, instants: Sequence[float], *, length: float, kg: float, direction: Array, bend: Array,
        gravity: Array, shaken: Array,
    ) -> Array:  # fmt: skip
        """Go on by one interval.

        Parameters
        ----------
        instants : sequence of float
            Within the interval, s from its beginning.
        length : float
            From O to the rope ends, m.
        kg : float
            Mass of the grab.
        direction, bend : ndarray, shape (3,)
            Unit vector along the ropes, and its second derivative, 1/s².
        gravity : ndarray, shape (3,)
            Less the acceleration of O, m/s².
        shaken : ndarray, shape (2,)
            Further acceleration of the exits, m/s².

        Returns
        -------
        ndarray, shape (n, 3, modes, 2)
            Amplitudes, their rates and accelerations at the instants.
        """
        j, odd = self._number, np.where(self._number % 2, 1.0, -1.0)
        pull = kg * max(float(gravity @ direction), _LEAST_PULL)
        frequency = j * (math.pi / length) * math.sqrt(pull / self._kg_m)
        still, swung = (_across(vector, direction)[:2] for vector in (gravity, bend))
        load = 2 / (j * math.pi) * ((1 + odd) * still - length * odd * swung - shaken)
        rest = load / frequency**2
        amplitude, rate = self._state or (rest, np.zeros_like(rest))
        slow = self._damping * frequency
        fast = np.sqrt(frequency**2 - slow**2)
        times = np.array([*instants, seconds])[:, None, None]
        cos, sin = np.cos(fast * times), np.sin(fast * times)
        first, second = amplitude - rest, (rate + slow * (amplitude - rest)) / fast
        decay = np.exp(-slow * times)
        value = decay * (first * cos + second * sin)
        change = decay * ((fast * second - slow * first) * cos - (fast * first + slow * second) * sin)
        self._state = value[-1] + rest, change[-1]
        return np.stack([value + rest, change, -2 * slow * change - frequency**2 * value], axis=1)[:-1]


class RopeWaves:
    """The waves of a clip's ropes, block by block of its motion, of a scenario whose suspension has them."""

    def __init__(self, scenario: Scenario, course: ClipMotion) -> None:
        waves, self._design = scenario.suspension.waves, design_of(scenario.grab)
        kg_m = len(self._design.terminations) * KG_M_MM2 * scenario.jib.rope_diameter_mm**2
        self._strings = Strings(waves.modes, waves.damping, kg_m)
        self._shaken = course.noise(low_pass(waves.bandwidth_hz), waves.exit_rms_m_s2, "waves")

    def advance(
        self, block: Block, which: NDArray[np.intp], late: Array, begun: dict[str, Array], fields: dict[str, Array]
    ) -> WaveAmplitudes:
        """Go on by a block.

        Parameters
        ----------
        which : ndarray of int, shape (n,)
            Increasing numbers of the block's intervals in which the instants are.
        late : ndarray, shape (n,)
            The instants since these began, s.
        begun, fields : dict of str to ndarray
            Fields of `Motion` at the beginnings of all intervals, and at the instants.
        """
        own = np.split(late, np.searchsorted(which, range(1, len(block.push))))
        amplitudes = [
            self._strings.step(
                block.interval, own[i].tolist(), length=float(begun["length"][i]),
                kg=self._design.mass_of(drive.jaw, drive.load).mass, direction=begun["direction"][i],
                bend=begun["direction_acceleration"][i], gravity=block.gravity[i], shaken=shaken,
            )
            for i, (drive, shaken) in enumerate(zip(block.drives(), next(self._shaken), strict=True))
        ]  # fmt: skip
        amplitude, rate, acceleration = np.concatenate(amplitudes).transpose(1, 0, 2, 3)
        return WaveAmplitudes(
            amplitude, rate, acceleration, fields["length"], fields["rope_rate"], fields["rope_acceleration"]
        )


def _across(vector: Array, direction: Array) -> Array:
    return np.asarray(vector - direction * (vector @ direction))

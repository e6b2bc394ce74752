"""The operator's work over time: slewing, luffing, hoisting, jaws and load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Cycles, Dynamic, Scenario, Turn
from simgrab.world.scenery.grabs import design_of
from simgrab.world.trajectory.axis import CommandedAxis, Move

KEPT_S = 30.0  # moves are kept so long after their end: displays lag
OPEN = 0.9  # of the widest opening
SLEW_RAMP_S, LUFF_RAMP_S = (9.0, 5.0), (4.0, 3.0)  # of a smooth and of a rough operator
OVERLAP = 0.3  # of its hoisting, during which a rough operator already slews
FILL_FROM = 0.6  # of the digging time, from which on the closing jaws hold cargo
SPREAD = 2.0  # standard deviations at which variation is cut off


@dataclass(frozen=True)
class Course:
    """The commanded course of a clip at some instants, arrays (n,); rad, m, s."""

    slew: Array
    slew_rate: Array
    luffed: Array
    luff_rate: Array
    rope: Array
    rope_rate: Array
    jaw: Array
    load: Array
    held: NDArray[np.bool_]  # the jaws are in the cargo, which holds the grab


class Work:
    """The course of one clip of a scenario with dynamic swing, made as far as requested; the past is forgotten."""

    def __init__(self, scenario: Scenario, clip: int) -> None:
        assert isinstance(scenario.swing, Dynamic)
        self._seed, self._clip, self._work = scenario.seed, clip, scenario.swing.work
        self._cycle, self._until = 0, 0.0
        design = design_of(scenario.grab)
        self._most_jaw, self._most_load = design.max_jaw, 1.0 if design.holds_cargo else 0.0
        self._open = OPEN * self._most_jaw
        self._holds: list[tuple[float, float]] = []
        work = self._work
        if isinstance(work, Cycles):
            rope, jaw, load = self._depth(self._vary(work.dig_rope_m, "dig_rope", 0)), self._open, 0.0
        else:
            if math.radians(work.jaw_deg) > self._most_jaw > 0:  # a grab without jaws stays closed
                raise ScenarioError(
                    "swing.work.jaw_deg", f"this grab opens by {math.degrees(self._most_jaw):g}°, got {work.jaw_deg:g}°"
                )
            rope, jaw, load = work.rope_length_m, min(math.radians(work.jaw_deg), self._most_jaw), work.load
            self._until = math.inf
        slew = math.radians(work.dig_slew_deg) if isinstance(work, Cycles) else 0.0
        self._axes = tuple(map(CommandedAxis, (slew, 0.0, rope, jaw, load)))
        self._slew, self._luff, self._rope, self._jaw, self._load = self._axes
        if isinstance(work, Turn):
            # Farther than any clip is long: it never arrives.
            speed = work.slew_rpm * 2 * math.pi / 60
            self._slew.add(Move.at_speed(work.wait_s, speed * 1e7, abs(speed) or 1.0, work.ramp_s))

    def sample(self, time: Array) -> Course:
        """Return the course at increasing instants; instants long before the last call are forgotten."""
        while self._until < time[-1]:
            self._plan_cycle()
        for axis in self._axes:
            axis.forget(float(time[0]) - KEPT_S)
        self._holds = [h for h in self._holds if h[1] > time[0] - KEPT_S]
        (slew, slew_rate), (luff, luff_rate), (rope, rope_rate), (jaw, _), (load, _) = (
            a.sample(time) for a in self._axes
        )
        held = np.zeros(len(time), bool)
        for begin, end in self._holds:
            held |= (time >= begin) & (time < end)
        jaw, load = np.clip(jaw, 0.0, self._most_jaw), np.clip(load, 0.0, self._most_load)
        return Course(slew, slew_rate, luff, luff_rate, rope, rope_rate, jaw, load, held)

    def slew_acceleration(self, time: Array) -> Array:
        """Return the angular acceleration of the jib, rad/s², at the latest sampled instants."""
        return self._slew.acceleration(time)

    def setpoints(self, time: Array) -> tuple[Array, Array]:
        """Return the speeds demanded of slewing and luffing, rad/s and m/s, at the latest sampled instants."""
        return self._slew.setpoint(time), self._luff.setpoint(time)

    def rope_and_jaw(self, time: float) -> tuple[float, float]:
        """|OA|, m, and opening of the jaws, rad, at an instant up to `KEPT_S` before the last sample."""
        when = np.array([time])
        return float(self._rope.sample(when)[0][0]), float(np.clip(self._jaw.sample(when)[0][0], 0.0, self._most_jaw))

    def _vary(self, value: float, name: str, cycle: int) -> float:
        """Value of one cycle, scattered by the scenario's variation."""
        assert isinstance(self._work, Cycles)
        scatter = stream(self._seed, cycle, f"clip/{self._clip}/cycle.{name}").standard_normal()
        return value * (1 + self._work.variation * float(np.clip(scatter, -SPREAD, SPREAD)))

    def _depth(self, rope: float) -> float:
        """Rope length at which a cycle digs: never below the scenario's, which is the ground, nor above carrying."""
        assert isinstance(self._work, Cycles)
        return max(min(rope, self._work.dig_rope_m), self._work.carry_rope_m)

    def _plan_cycle(self) -> None:
        """Append one cycle to all axes: dig, hoist, slew and luff, dump, return and lower."""
        work, k = self._work, self._cycle
        assert isinstance(work, Cycles)
        ramp_slew, ramp_luff = (
            self._vary(a + (b - a) * work.operator, f"{axis}_ramp", k)
            for axis, (a, b) in (("slew", SLEW_RAMP_S), ("luff", LUFF_RAMP_S))
        )
        hoist = self._vary(work.hoist_m_min / 60, "hoist", k)
        slew = self._vary(work.slew_rpm * 2 * math.pi / 60, "slew", k)
        luff = self._vary(work.luff_m_min / 60, "luff", k)
        arc, reach = math.radians(self._vary(work.slew_deg, "arc", k)), self._vary(work.luff_m, "reach", k)
        dig_s, dump_s = self._vary(work.dig_s, "dig_s", k), self._vary(work.dump_s, "dump_s", k)
        fill = min(self._vary(1 - work.variation, "fill", k), 1.0)
        pauses = [self._vary(work.pause_s, f"pause_{i}", k) for i in range(2)]
        deep = self._depth(self._vary(work.dig_rope_m, "dig_rope", k))
        next_deep = self._depth(self._vary(work.dig_rope_m, "dig_rope", k + 1))
        overlap = OVERLAP * work.operator

        begin = self._until
        self._holds.append((begin, begin + dig_s))
        self._jaw.add(Move.in_time(begin, -self._open, dig_s))
        self._load.add(Move.in_time(begin + FILL_FROM * dig_s, fill, (1 - FILL_FROM) * dig_s))
        up = self._rope.add(Move.at_speed(begin + dig_s, work.carry_rope_m - deep, hoist, hoist / work.hoist_m_s2))
        away = up.end - overlap * up.duration
        abrupt = work.abrupt_every > 0 and (k + 1) % work.abrupt_every == 0
        out = [
            self._slew.add(Move.at_speed(away, arc, slew, ramp_slew, work.abrupt_s if abrupt else ramp_slew)),
            self._luff.add(Move.at_speed(away, reach, luff, ramp_luff)),
        ]
        dump = max(up.end, *(m.end for m in out)) + pauses[0] * (1 - work.operator)
        self._jaw.add(Move.in_time(dump, self._open, dump_s))
        self._load.add(Move.in_time(dump, -fill, dump_s / 2))
        home = dump + dump_s
        back = [
            self._slew.add(Move.at_speed(home, -arc, slew, ramp_slew)),
            self._luff.add(Move.at_speed(home, -reach, luff, ramp_luff)),
        ]
        last = max(m.end for m in back)
        lower = last - overlap * (last - home)
        down = self._rope.add(Move.at_speed(lower, next_deep - work.carry_rope_m, hoist, hoist / work.hoist_m_s2))
        self._until = max(last, down.end) + pauses[1]
        self._cycle += 1

"""One axis of the crane: a chain of moves from rest to rest, each with a trapezoidal velocity."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Move:
    """A move from rest to rest: velocity rises over ``ramp``, stays constant, and falls over ``brake``."""

    start: float  # s
    distance: float  # in the axis' unit (m or rad), signed
    # duration, ramp, brake: s
    duration: float
    ramp: float
    brake: float

    @classmethod
    def in_time(cls, start: float, distance: float, duration: float) -> Move:
        """Make a move that only accelerates and brakes."""
        return cls(start, distance, duration, duration / 2, duration / 2)

    @classmethod
    def at_speed(cls, start: float, distance: float, speed: float, ramp: float, brake: float | None = None) -> Move:
        """Make a move with ``speed``, or less if the distance is too short; it brakes as fast as it starts."""
        brake = ramp if brake is None else brake
        mean = (ramp + brake) / 2
        top = min(speed, abs(distance) / mean)
        if not top:  # no distance, or one too small to distinguish from none
            return cls(start, 0.0, 0.0, ramp, brake)
        return cls(start, distance, abs(distance) / top + mean, ramp, brake)

    @property
    def end(self) -> float:
        """Time of the end, s."""
        return self.start + self.duration

    @property
    def top(self) -> float:
        """Greatest velocity, signed."""
        return self.distance / (self.duration - (self.ramp + self.brake) / 2) if self.distance else 0.0

    def setpoint(self, time: Array) -> Array:
        """Velocity that is demanded of the drive, which follows it in ramps."""
        u = time - self.start
        return np.where((u >= 0) & (u < self.duration - self.brake), self.top, 0.0)

    def progress(self, time: Array) -> tuple[Array, Array]:
        """Distance gone, and velocity."""
        if not self.distance:
            return np.zeros_like(time), np.zeros_like(time)
        u = np.clip(time - self.start, 0.0, self.duration)
        rising, falling = np.minimum(u, self.ramp), np.minimum(self.duration - u, self.brake)
        gone = rising**2 / (2 * self.ramp) + np.maximum(u - self.ramp, 0.0)
        gone -= (self.brake - falling) ** 2 / (2 * self.brake)
        return self.top * gone, self.top * np.minimum(rising / self.ramp, falling / self.brake)

    def acceleration(self, time: Array) -> Array:
        """Acceleration; at a jump, the value after it."""
        if not self.distance:
            return np.zeros_like(time)
        u = time - self.start
        rises, falls = (u >= 0) & (u < self.ramp), (u >= self.duration - self.brake) & (u < self.duration)
        return np.asarray(self.top * (rises / self.ramp - falls / self.brake))


@dataclass
class CommandedAxis:
    """Commanded position of an axis over time. Moves are appended in order and forgotten when long past."""

    rest: float
    moves: list[Move] = field(default_factory=list)

    def add(self, move: Move) -> Move:
        """Append a move."""
        self.moves.append(move)
        return move

    def sample(self, time: Array) -> tuple[Array, Array]:
        """Position and velocity."""
        position, velocity = np.full_like(time, self.rest), np.zeros_like(time)
        for move in self.moves:
            gone, speed = move.progress(time)
            position += gone
            velocity += speed
        return position, velocity

    def acceleration(self, time: Array) -> Array:
        """Acceleration."""
        return np.asarray(sum((move.acceleration(time) for move in self.moves), np.zeros_like(time)))

    def setpoint(self, time: Array) -> Array:
        """Velocity that is demanded of the drive."""
        return np.asarray(sum((move.setpoint(time) for move in self.moves), np.zeros_like(time)))

    def forget(self, before: float) -> None:
        """Drop moves that ended before a time; positions after it stay."""
        while self.moves and self.moves[0].end < before:
            self.rest += self.moves.pop(0).distance

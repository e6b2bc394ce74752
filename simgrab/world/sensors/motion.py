"""The motion of a clip at any instants, consistent with its frames, with rates and accelerations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Dynamic, Scenario
from simgrab.world.sensors.table import ROPE_WAVES, implementation
from simgrab.world.trajectory.clip import Block, ClipMotion
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt
from simgrab.world.trajectory.mount import Mount
from simgrab.world.trajectory.noise import BLOCK
from simgrab.world.trajectory.plant import GRAB, LENGTH, ROPES, Plant
from simgrab.world.trajectory.work import Work

Instants = Callable[[float, float], Array]
"""From the ends of a span of time to increasing instants within it, the first end included."""


class Displacement(Protocol):
    """Displacement of the ropes from straight lines at n instants, in the pivot frame of `Motion`."""

    def __getitem__(self, which: NDArray[np.intp]) -> Displacement:
        """Return the displacement at some of the instants."""

    def at(self, distance: float) -> tuple[Array, Array, Array]:
        """Acceleration, slope and its rate at a distance from O, m, shape (n, 3) each; m/s², 1 and 1/s."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Crane, ropes, grab and camera at n instants, SI units and radians.

    Vectors are in the *pivot frame* unless stated: its origin is O, and its axes are those of the unslewed jib frame,
    which do not turn. T is the middle of the rope ends, on the grab's axis.
    """

    time: Array  # (n,), since the clip began
    attitude: Array  # (n, 3, 3), rotation of the grab's frame in the pivot frame
    rate: Array  # (n, 3), its angular velocity, grab frame
    direction: Array  # (n, 3), unit vector from O to T
    direction_rate: Array  # (n, 3)
    direction_acceleration: Array  # (n, 3)
    rope: Array  # (n,), length paid out: |OT| + |TA|
    rope_rate: Array  # (n,)
    rope_acceleration: Array  # (n,)
    length: Array  # (n,), |OT|
    gravity: Array  # (n, 3), less the acceleration of O
    wind: Array  # (n, 2), velocity of the air, m/s
    slew: Array  # (n,), slewing angle of the jib
    slew_rate: Array  # (n,)
    slew_acceleration: Array  # (n,)
    slew_setpoint: Array  # (n,), speeds that are demanded of the drives, which follow them in ramps
    luff_setpoint: Array  # (n,)
    radius: Array  # (n,), distance from the slewing axis to O
    luffed: Array  # (n,), growth of `radius`
    jaw: Array  # (n,), opening of the jaws
    load: Array  # (n,), fill
    held: NDArray[np.bool_]  # (n,), whether cargo holds the grab: it digs
    shake: Array  # (n, 2), lean of the jib head from vibration, jib frame, as the tangent of its angle
    shake_rate: Array  # (n, 2)
    lean: Array  # (n, 2), lean of the camera about its attitude at rest, `shake` included
    lean_rate: Array  # (n, 2)
    waves: Displacement | None = None  # None if the ropes are straight

    def __getitem__(self, which: NDArray[np.intp]) -> Motion:
        parts: dict[str, Any] = {name: None if values is None else values[which] for name, values in vars(self).items()}
        return Motion(**parts)

    @property
    def centre(self) -> Array:
        """OA, m, shape (n, 3)."""
        return np.asarray(
            self.length[:, None] * self.direction - (self.rope - self.length)[:, None] * self.attitude[:, :, 2]
        )

    @property
    def swing(self) -> tuple[Array, Array]:
        """α and its azimuth in the jib frame, rad, shape (n,) each."""
        alpha, azimuth, _ = geometry.swing_of(np.einsum("nij,nj->ni", geometry.rotation_z(-self.slew), self.centre))
        return alpha, azimuth

    def moment(self, i: int) -> Moment:
        """Return the moment of pictures at an instant; its camera hangs straight."""
        back = geometry.rotation_z(-float(self.slew[i]))
        attitude = back @ self.attitude[i]
        lean, leaning, _ = (float(value) for value in geometry.swing_of(-attitude[:, 2]))
        alpha, azimuth, rope = (float(value) for value in geometry.swing_of(back @ self.centre[i]))
        turn = geometry.lean(lean, leaning).T @ attitude
        yaw = math.atan2(turn[1, 0], turn[0, 0])
        grab = GrabState(alpha, azimuth, rope, yaw, float(self.jaw[i]), float(self.load[i]), (lean, leaning))
        jib = JibState(float(self.slew[i]), float(self.radius[i]), float(self.luffed[i]))
        return replace(Moment.still(0, grab, Tilt(0.0, 0.0, 0.0)), time=float(self.time[i]), jib=jib)


def motions(scenario: Scenario, clip: int, instants: Instants) -> Iterator[Motion]:
    """Yield the motion of a clip at instants, some seconds at a time.

    It is integrated in the same steps as for frames. The forces that drive it are constant during each of the plant's
    intervals of at most 20 ms, so that accelerations jump between these. The scenario has dynamic swing, and nothing
    varies in it.
    """
    assert isinstance(scenario.swing, Dynamic)
    course, work = ClipMotion(scenario, clip), Work(scenario, clip)
    mount, interval = Mount(scenario.camera, course.interval), course.interval
    end = len(scenario.span(clip)) / scenario.clip.frame_rate_hz
    waving = None
    if scenario.suspension.waves.modes:
        waving = implementation(ROPE_WAVES, "suspension.waves")(scenario, course)
    plant: Plant | None = None
    before: Block | None = None
    for block, after in itertools.pairwise(course.blocks(Work(scenario, clip))):
        begin, until = max(block.count * interval, 0.0), min((block.count + BLOCK) * interval, end)
        if begin >= end:
            return
        time = instants(begin, until) if until > 0 else np.zeros(0)
        which = np.clip((time / interval).astype(int) - block.count, 0, BLOCK - 1)
        late = np.clip(time - (which + block.count) * interval, 0.0, interval)
        rows = []
        for drive, own in zip(block.drives(), np.split(late, np.searchsorted(which, range(1, BLOCK))), strict=True):
            plant = plant or course.plant(drive)
            rows.append(plant.run(drive, interval, course.steps, [*([0.0] if waving else []), *own.tolist()]))
        assert plant is not None
        waves = None
        if waving:
            begun = _hung(np.array([each[0] for each in rows]), plant.end_height)
            rows = [each[1:] for each in rows]
        fields = _hung(np.concatenate(rows), plant.end_height)
        if waving:
            waves = waving.advance(block, which, late, begun, fields)
        if len(time):
            sampled = work.sample(time + course.warm_up_s)
            slew_setpoint, luff_setpoint = work.setpoints(time + course.warm_up_s)
            leans = mount.within(block.lean[which], late, block.felt[which], sampled.luffed, sampled.luff_rate)
            shake, shake_rate = _between(_padded(before, block, after), which, late / interval)
            shake_rate = shake_rate / interval
            yield Motion(
                time=time, **fields, waves=waves, gravity=block.gravity[which], wind=block.wind[which],
                slew=sampled.slew, slew_rate=sampled.slew_rate,
                slew_acceleration=work.slew_acceleration(time + course.warm_up_s),
                slew_setpoint=slew_setpoint, luff_setpoint=luff_setpoint,
                radius=scenario.swing.radius_m + sampled.luffed, luffed=sampled.luffed,
                jaw=sampled.jaw, load=sampled.load, held=sampled.held, shake=shake, shake_rate=shake_rate,
                lean=leans[:, 0] + shake, lean_rate=leans[:, 1] + shake_rate,
            )  # fmt: skip
        before = block


def _hung(rows: Array, end_height: float) -> dict[str, Array]:
    """Fields of `Motion` about ropes and grab, from rows of `Plant.run`."""
    ropes, grab = rows[:, ROPES], rows[:, GRAB]
    rope, rope_rate, rope_acceleration = rows[:, LENGTH].T
    # The ropes' axis, downwards, in their frame: its velocity and acceleration are ω × e and ω̇ × e + ω × (ω × e).
    down, rate = np.array([0.0, 0.0, -1.0]), ropes[:, 4:7]
    swung = np.cross(rate, down)
    attitude = _rotations(ropes)
    directions = (
        np.einsum("nij,nj->ni", attitude, vector)
        for vector in (np.broadcast_to(down, rate.shape), swung, np.cross(ropes[:, 7:], down) + np.cross(rate, swung))
    )
    direction, direction_rate, direction_acceleration = directions
    return {
        "attitude": _rotations(grab), "rate": grab[:, 4:7],
        "direction": direction, "direction_rate": direction_rate, "direction_acceleration": direction_acceleration,
        "rope": rope, "rope_rate": rope_rate, "rope_acceleration": rope_acceleration, "length": rope - end_height,
    }  # fmt: skip


def _rotations(bodies: Array) -> Array:
    return Rotation.from_quat(bodies[:, :4], scalar_first=True).as_matrix()


def _padded(before: Block | None, block: Block, after: Block) -> Array:
    """Vibration of a block with one value before it and two after it, shape (BLOCK + 3, 2)."""
    shake = block.shake
    first = 2 * shake[0] - shake[1] if before is None else before.shake[-1]
    return np.concatenate([first[None], shake, after.shake[:2]])


def _between(values: Array, which: NDArray[np.intp], share: Array) -> tuple[Array, Array]:
    """Catmull-Rom curve through values, and its derivative by the share of the way from value ``which + 1`` on."""
    a, b, c, d = (values[which + k] for k in range(4))
    s = share[:, None]
    curve = np.stack([b, (c - a) / 2, a - 2.5 * b + 2 * c - d / 2, (d - a) / 2 + 1.5 * (b - c)])
    return (
        curve[0] + s * (curve[1] + s * (curve[2] + s * curve[3])),
        curve[1] + s * (2 * curve[2] + s * 3 * curve[3]),
    )

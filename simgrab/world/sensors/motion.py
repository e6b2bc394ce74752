"""The motion of a clip at any instants, as its frames have it at theirs, with rates and accelerations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Dynamic, Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.sensors.waves import KG_M_MM2, Strings, Waves
from simgrab.world.trajectory.clip import Block, ClipMotion
from simgrab.world.trajectory.linked import LinkedPlant, directions
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt
from simgrab.world.trajectory.mount import Mount
from simgrab.world.trajectory.noise import BLOCK
from simgrab.world.trajectory.plant import Drive, Plant
from simgrab.world.trajectory.work import Work

Instants = Callable[[float, float], Array]
"""From the ends of a span of time to increasing instants within it, the first end included."""


@dataclass(frozen=True, eq=False)
class Link:
    """Ropes that lean otherwise than the grab, at n instants.

    Attributes
    ----------
    direction, direction_rate, direction_acceleration : ndarray, shape (n, 3)
        Unit vector from O to T, the middle of the rope ends, with its derivatives; pivot frame of `Motion`.
    end_height : ndarray, shape (n,)
        Of T in the grab's frame, m.
    """

    direction: Array
    direction_rate: Array
    direction_acceleration: Array
    end_height: Array

    def __getitem__(self, which: NDArray[np.intp]) -> Link:
        return Link(**{name: values[which] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Motion:
    """Crane, grab and camera at n instants, SI units and radians.

    Vectors are in the *pivot frame*, whose origin is O and whose axes are those of the jib frame unslewed, which do not
    turn; except where said.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Since the clip began.
    attitude : ndarray, shape (n, 3, 3)
        Rotation of the grab's frame in the pivot frame.
    rate, acceleration : ndarray, shape (n, 3)
        Its angular velocity and acceleration, grab frame.
    rope, rope_rate, rope_acceleration : ndarray, shape (n,)
        What is paid out: |OA|, or where the grab leans otherwise than its ropes, |OT| and the height of T over A.
    gravity : ndarray, shape (n, 3)
        Less the acceleration of O.
    slew, slew_rate, slew_acceleration : ndarray, shape (n,)
        Of the jib.
    radius, luffed : ndarray, shape (n,)
        From the slewing axis to O, and by how much that has grown.
    jaw, load : ndarray, shape (n,)
        Opening of the jaws, and fill.
    shake, shake_rate : ndarray, shape (n, 2)
        Lean of the jib head from vibration, jib frame, as the tangent of its angle.
    lean, lean_rate : ndarray, shape (n, 2)
        Lean of the camera about its attitude at rest, ``shake`` included.
    link : Link or None
        None where grab and ropes are one body.
    waves : Waves or None
        None where the ropes are straight.
    """

    time: Array
    attitude: Array
    rate: Array
    acceleration: Array
    rope: Array
    rope_rate: Array
    rope_acceleration: Array
    gravity: Array
    slew: Array
    slew_rate: Array
    slew_acceleration: Array
    radius: Array
    luffed: Array
    jaw: Array
    load: Array
    shake: Array
    shake_rate: Array
    lean: Array
    lean_rate: Array
    link: Link | None = None
    waves: Waves | None = None

    def __getitem__(self, which: NDArray[np.intp]) -> Motion:
        parts: dict[str, Any] = {name: None if values is None else values[which] for name, values in vars(self).items()}
        return Motion(**parts)

    @property
    def ropes(self) -> tuple[Array, Array, Array]:
        """Unit vectors along the straight ropes, pivot frame, with two derivatives, shape (n, 3) each."""
        if self.link is not None:
            return self.link.direction, self.link.direction_rate, self.link.direction_acceleration
        return _along(self.attitude, self.rate, self.acceleration)

    @property
    def centre(self) -> Array:
        """Vector along OA, pivot frame, shape (n, 3): of length 1 where grab and ropes are one body, else |OA| m."""
        up, link = self.attitude[:, :, 2], self.link
        if link is None:
            return -up
        return (self.rope - link.end_height)[:, None] * link.direction - link.end_height[:, None] * up

    def moment(self, i: int) -> Moment:
        """Give what pictures show at an instant; the camera hangs straight there."""
        back = geometry.rotation_z(-float(self.slew[i]))
        attitude, centre = back @ self.attitude[i], back @ self.centre[i]
        alpha, azimuth, rope = (float(value) for value in geometry.swing_of(centre))
        head = None
        if self.link is None:
            rope *= float(self.rope[i])
        else:
            lean, leaning, _ = geometry.swing_of(-attitude[:, 2])
            head = float(lean), float(leaning)
        turn = geometry.lean(*(head or (alpha, azimuth))).T @ attitude
        yaw = math.atan2(turn[1, 0], turn[0, 0])
        grab = GrabState(alpha, azimuth, rope, yaw, float(self.jaw[i]), float(self.load[i]), head)
        jib = JibState(float(self.slew[i]), float(self.radius[i]), float(self.luffed[i]))
        return replace(Moment.still(0, grab, Tilt(0.0, 0.0, 0.0)), time=float(self.time[i]), jib=jib)

    @property
    def swing(self) -> tuple[Array, Array]:
        """α and its azimuth in the jib frame, rad, shape (n,) each."""
        down = np.einsum("nij,nj->ni", geometry.rotation_z(-self.slew), self.centre)
        alpha, azimuth, _ = geometry.swing_of(down)
        return alpha, azimuth


def motions(scenario: Scenario, clip: int, instants: Instants) -> Iterator[Motion]:
    """Give the motion of a clip at instants, some seconds at a time.

    It is integrated in the same steps as for frames. The forces that drive it are constant during each of the plant's
    intervals of at most 20 ms, so that accelerations jump between these. By how much moving jaws change the angular
    velocity at an interval's beginning counts as acceleration throughout the interval.

    Parameters
    ----------
    scenario : Scenario
        With dynamic swing, and nothing that varies.
    clip : int
    instants : callable

    Yields
    ------
    Motion
    """
    assert isinstance(scenario.swing, Dynamic)
    radius, course, work = scenario.swing.radius_m, ClipMotion(scenario, clip), Work(scenario, clip)
    mount, interval = Mount(scenario.camera, course.interval), course.interval
    end = len(scenario.span(clip)) / scenario.clip.frame_rate_hz
    plant: Plant | LinkedPlant | None = None
    waving = _Waving(course, scenario)
    before: Array | None = None
    blocks = course.blocks(Work(scenario, clip))
    block, after = next(blocks), next(blocks)
    while block.count * interval < end:
        begin = max(block.count * interval, 0.0)
        time = instants(begin, min((block.count + BLOCK) * interval, end)) if block.count > -BLOCK else np.zeros(0)
        which = np.clip((time / interval).astype(int) - block.count, 0, BLOCK - 1)
        late = np.clip(time - (which + block.count) * interval, 0.0, interval)
        sampled = work.sample(time + course.settled_s) if len(time) else None
        first = np.searchsorted(which, np.arange(BLOCK + 1))
        states, leaning = [], [np.empty((0, 4))]
        waving.begin()
        for i, (drive, jaw, load) in enumerate(block.drives()):
            if plant is None:
                plant = course.plant(drive.rope, jaw, load)
            rate = plant.rates()
            plant.hold(jaw, load)
            jump = plant.rates() - rate
            own = slice(first[i], first[i + 1])
            states.append(waving.watch(plant, i, drive, course.steps, late[own].tolist()))
            states[-1][:, plant.ACCELERATIONS] += jump / interval  # in the plant all at once
            if sampled is not None and own.stop > own.start:
                leans = mount.leaning(late[own], block.felt[i], sampled.luffed[own], sampled.luff_rate[own])
                leaning.append(np.hstack(leans))
            mount.step(block.felt[i], float(block.course.luffed[i + 1]))
        if sampled is not None:
            state, lean = np.concatenate(states), np.concatenate(leaning)
            shake, shake_rate = _between(_padded(before, block, after), which, late / interval)
            shake_rate = shake_rate / interval
            fields = _linked(state, plant) if isinstance(plant, LinkedPlant) else _one_body(state)
            yield Motion(
                time=time, **fields, waves=waving.motion(fields),
                gravity=block.gravity[which],
                slew=sampled.slew, slew_rate=sampled.slew_rate,
                slew_acceleration=work.slew_acceleration(time + course.settled_s),
                radius=radius + sampled.luffed, luffed=sampled.luffed, jaw=sampled.jaw, load=sampled.load,
                shake=shake, shake_rate=shake_rate,
                lean=lean[:, :2] + shake, lean_rate=lean[:, 2:] + shake_rate,
            )  # fmt: skip
        before, block, after = block.shake[-1], after, next(blocks)


def _one_body(state: Array) -> dict[str, Any]:
    """Fields of `Motion` from rows of `Plant.watch`."""
    return {
        "attitude": Rotation.from_quat(state[:, :4], scalar_first=True).as_matrix(),
        "rate": state[:, 5:8], "acceleration": state[:, 9:12],
        "rope": -state[:, 4], "rope_rate": -state[:, 8], "rope_acceleration": -state[:, 12],
    }  # fmt: skip


def _linked(state: Array, plant: LinkedPlant) -> dict[str, Any]:
    """Fields of `Motion` from rows of `LinkedPlant.watch`."""
    height = np.full(len(state), plant.end_height)
    leaning = zip(state[:, :2], state[:, 7:9], state[:, 13:15], strict=True)
    direction = np.reshape([directions(*lean) for lean in leaning], (-1, 3, 3))
    return {
        "attitude": Rotation.from_quat(state[:, 2:6], scalar_first=True).as_matrix(),
        "rate": state[:, 9:12], "acceleration": state[:, 15:18],
        "rope": state[:, 6] + height, "rope_rate": state[:, 12], "rope_acceleration": state[:, 18],
        "link": Link(direction[:, 0], direction[:, 1], direction[:, 2], height),
    }  # fmt: skip


def _along(attitude: Array, rate: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Give the direction of ropes that a grab leans with, shape (n, 3), and its two derivatives."""
    axis = np.array([0.0, 0.0, 1.0])
    swung = np.cross(rate, axis)  # of the rope's axis, grab frame
    bend = np.cross(acceleration, axis) + np.cross(rate, swung)
    return -attitude[:, :, 2], *(-np.einsum("nij,nj->ni", attitude, vector) for vector in (swung, bend))


class _Waving:
    """The ropes' waves of a clip, beside its plant; nothing where they have none."""

    def __init__(self, course: ClipMotion, scenario: Scenario) -> None:
        waves, grab = scenario.suspension.waves, design_of(scenario.grab)
        ropes, self._end = len(grab.terminations), float(grab.terminations[0, 2])
        kg_m = ropes * KG_M_MM2 * scenario.jib.rope_diameter_mm**2
        self._strings = Strings(waves.modes, waves.damping, kg_m) if waves.modes else None
        self._interval, self._modes = course.interval, waves.modes
        self._shaken = course.exit_shaking() if waves.modes else None
        self._now, self._rows = np.zeros((BLOCK, 2)), [np.empty((0, 3, waves.modes, 2))]

    def begin(self) -> None:
        """Begin a block of intervals."""
        self._rows = self._rows[:1]
        if self._shaken is not None:
            self._now = next(self._shaken)

    def watch(self, plant: Plant | LinkedPlant, number: int, drive: Drive, steps: int, instants: list[float]) -> Array:
        """Let a plant run one interval of the block, and the waves with it; its rows as of `Plant.watch`."""
        if self._strings is None:
            return plant.watch(drive, self._interval, steps, instants)
        rows = plant.watch(drive, self._interval, steps, [0.0, *instants])
        fields = _linked(rows[:1], plant) if isinstance(plant, LinkedPlant) else _one_body(rows[:1])
        link = fields.get("link")
        along = _along(fields["attitude"], fields["rate"], fields["acceleration"]) if link is None else (
            link.direction, link.direction_rate, link.direction_acceleration
        )  # fmt: skip
        self._rows.append(self._strings.step(
            self._interval, instants, length=float(fields["rope"][0]) - self._end, kg=plant.mass.mass,
            direction=along[0][0], bend=along[2][0], gravity=np.array(drive.gravity), shaken=self._now[number],
        ))  # fmt: skip
        return rows[1:]

    def motion(self, fields: dict[str, Any]) -> Waves | None:
        """Give the waves at the block's instants, from other fields of `Motion`."""
        if self._strings is None:
            return None
        amplitude, rate, acceleration = np.concatenate(self._rows).transpose(1, 0, 2, 3)
        length = fields["rope"] - self._end
        return Waves(amplitude, rate, acceleration, length, fields["rope_rate"], fields["rope_acceleration"])


def _padded(before: Array | None, block: Block, after: Block) -> Array:
    """Vibration of a block with one value before it and two after it, shape (BLOCK + 3, 2)."""
    shake = block.shake
    first = 2 * shake[0] - shake[1] if before is None else before
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

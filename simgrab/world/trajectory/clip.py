"""A clip's moments, one after another, in bounded memory."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.model.scenario import Dynamic, OneBody, Scenario, Start
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.display import Shown, shown
from simgrab.world.trajectory.linked import LinkedPlant
from simgrab.world.trajectory.moment import GrabState, JibState, Moment
from simgrab.world.trajectory.mount import Mount
from simgrab.world.trajectory.noise import BLOCK, Shape, low_pass, narrow_band, noise, von_karman
from simgrab.world.trajectory.plant import MOST_STEP_S, Drive, Plant, turned
from simgrab.world.trajectory.work import Course, Work

MOST_INTERVAL_S = 0.02  # between changes of what acts on the grab


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """What drives a clip during `BLOCK` intervals. Vectors are in axes that do not turn, except where said.

    Attributes
    ----------
    count : int
        Number of the first interval; interval 0 begins with the first frame.
    interval : float
        s.
    course : Course
        At both ends of all intervals, one instant more than these.
    gravity : ndarray, shape (BLOCK, 3)
        Less O's mean acceleration, m/s².
    velocity : ndarray, shape (BLOCK + 1, 2)
        Of O, at the intervals' ends, m/s.
    felt : ndarray, shape (BLOCK, 3)
        ``gravity`` in the jib frame of the interval's beginning.
    wind, push : ndarray, shape (BLOCK, 2)
        m/s, and m/s².
    shake : ndarray, shape (BLOCK, 2)
        Lean of the jib head from vibration at the intervals' beginnings, jib frame, rad.
    """

    count: int
    interval: float
    course: Course
    gravity: Array
    velocity: Array
    felt: Array
    wind: Array
    push: Array
    shake: Array

    def drives(self) -> Iterator[tuple[Drive, float, float]]:
        """Give for each interval what acts on the grab, the jaws' opening and the load."""
        course = self.course
        columns = (
            self.gravity, self.velocity[:-1], (course.slew[:-1] + course.slew[1:]) / 2, course.rope[:-1],
            course.rope_rate[:-1], np.diff(course.rope_rate) / self.interval, self.wind, self.push, course.held[:-1],
        )  # fmt: skip
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return zip((Drive(*row) for row in rows), course.jaw[:-1].tolist(), course.load[:-1].tolist(), strict=True)


class ClipMotion:
    """One clip. Iterate over it for its `Moment`s, from the first frame on, without end.

    Parameters
    ----------
    scenario : Scenario
        With dynamic swing.
    clip : int
        Its index; each clip has draws of its own.
    """

    def __init__(self, scenario: Scenario, clip: int) -> None:
        assert isinstance(scenario.swing, Dynamic)
        self._scenario, self._swing, self._clip = scenario, scenario.swing, clip
        self._grab = design_of(scenario.grab)
        period = 1 / scenario.clip.frame_rate_hz
        self._per_frame = math.ceil(period / MOST_INTERVAL_S)
        self.interval = period / self._per_frame
        self.steps = math.ceil(self.interval / MOST_STEP_S)
        self._settle = math.ceil(self._swing.settle_s / period)  # frames before the first
        self._first = scenario.span(clip).start  # frame
        self._layout = scenario.display_layout

    def __iter__(self) -> Iterator[Moment]:
        work, mount = Work(self._scenario, self._clip), Mount(self._scenario.camera, self.interval)
        plant: Plant | LinkedPlant | None = None
        for block in self.blocks(work):
            course, felt, shake = block.course, block.felt, block.shake
            for i, (drive, jaw, load) in enumerate(block.drives()):
                if plant is None:
                    plant = self.plant(drive.rope, jaw, load)
                count, moment = block.count + i, None
                if count >= 0 and count % self._per_frame == 0:
                    moment = self._moment(count / self._per_frame, plant, course, i, felt[i], mount, shake[i])
                    if self._layout:
                        moment = dataclasses.replace(moment, shown=self._shown(moment, work))
                plant.hold(jaw, load)
                plant.run(drive, self.interval, self.steps)
                mount.step(felt[i], float(course.luffed[i + 1]))
                if moment and self._scenario.shutter.open_s > 0:
                    after = min(i + 1, BLOCK - 1)  # the next block's tremble and pull are not drawn yet
                    ahead = self._moment(
                        (count + 1) / self._per_frame, plant, course, i + 1, felt[after], mount, shake[after]
                    )
                    moment = dataclasses.replace(moment, ahead=ahead)
                if moment:
                    yield moment

    @property
    def settled_s(self) -> float:
        """Time that runs before the first frame, by which the work's clock is ahead of the clip's."""
        return self._settle * self._per_frame * self.interval

    def blocks(self, work: Work) -> Iterator[Block]:
        """Give what drives the clip, block by block, without end; ``work`` is sampled as they are asked for."""
        noises = zip(self._wind(), self._forcing(), self._vibration(), strict=True)
        for block, (wind, push, shake) in enumerate(noises):
            # One instant more than intervals: each takes its mean accelerations from both its ends.
            ticks = np.arange(block * BLOCK, (block + 1) * BLOCK + 1, dtype=float)
            course = work.sample(self.interval * ticks)
            velocity = _velocity(self._swing.radius_m, course)
            gravity = np.full((BLOCK, 3), -STANDARD_GRAVITY)
            gravity[:, :2] = -np.diff(velocity, axis=0) / self.interval
            count = block * BLOCK - self._settle * self._per_frame
            felt = turned(gravity, -course.slew[:-1])
            yield Block(count, self.interval, course, gravity, velocity, felt, wind, push, shake)

    def plant(self, rope: float, jaw: float, load: float) -> Plant | LinkedPlant:
        """Make the grab as the clip begins."""
        swing, suspension = self._swing, self._scenario.suspension
        drag_area = self._grab.cd_a_m2 if swing.drag_area_m2 is None else swing.drag_area_m2
        ropes = Ropes.of(self._scenario.jib, len(self._grab.terminations))
        shares = {"damping": swing.damping, "yaw_damping": swing.yaw_damping, "drag_area": drag_area}
        if not isinstance(suspension, OneBody):
            linked = LinkedPlant(self._grab, ropes, rope, jaw, load, suspension=suspension, **shares)
            linked.begin(swing.start)
            return linked
        plant = Plant(self._grab, ropes, rope, jaw, load, **shares)
        plant.start(*_begin(swing.start, plant.mass, rope))
        return plant

    def _moment(
        self, index: float, plant: Plant | LinkedPlant, course: Course, i: int, felt: Array, mount: Mount, shake: Array
    ) -> Moment:
        scenario, slew = self._scenario, float(course.slew[i])
        hung = plant.hung(slew)
        luffed, tilt = float(course.luffed[i]), mount.tilt(shake)
        return Moment(
            frame=self._first + int(index),
            grab=GrabState(
                alpha=hung.alpha,
                azimuth=hung.azimuth,
                rope_length=hung.rope_length,
                yaw=float(geometry.wrap(hung.yaw)),
                jaw=float(course.jaw[i]),
                load=float(course.load[i]),
                head=hung.head,
            ),
            tilt=tilt,
            gamma=(hung.azimuth - tilt.azimuth) % (2 * math.pi),
            clip=self._clip,
            time=index / scenario.clip.frame_rate_hz,
            jib=JibState(slew, self._swing.radius_m + luffed, luffed),
            apparent_gravity=(float(felt[0]), float(felt[1]), float(felt[2])),
        )

    def _shown(self, moment: Moment, work: Work) -> Shown:
        """Work out what the display shows; its clock runs on from clip to clip."""
        assert self._layout is not None
        began = self._first / self._scenario.clip.frame_rate_hz
        settled = self._settle * self._per_frame * self.interval

        def lengths(time: float) -> tuple[float, float]:
            rope, jaw = work.rope_and_jaw(max(time - began + settled, 0.0))
            return rope, rope + self._grab.closing_rope_m(jaw)

        return shown(self._scenario.display, self._layout, moment.frame / self._scenario.clip.frame_rate_hz, lengths)

    def _wind(self) -> Iterator[Array]:
        wind = self._swing.wind
        along = np.array([math.cos(math.radians(wind.azimuth_deg)), math.sin(math.radians(wind.azimuth_deg))])
        mean = wind.mean_m_s * along
        turn = np.column_stack([along, (-along[1], along[0])])
        gusts = wind.mean_m_s * wind.intensity
        shape = von_karman(wind.scale_m, wind.mean_m_s) if gusts else None
        return (mean + block @ turn.T for block in self._noise(shape, gusts, "wind"))

    def _forcing(self) -> Iterator[Array]:
        forcing = self._swing.forcing
        return self._noise(low_pass(forcing.bandwidth_hz), forcing.rms_m_s2, "forcing")

    def _vibration(self) -> Iterator[Array]:
        vibration = self._scenario.camera.mount.vibration
        shape = narrow_band(vibration.frequency_hz, vibration.damping)
        return self._noise(shape, math.radians(vibration.rms_deg), "vibration")

    def exit_shaking(self) -> Iterator[Array]:
        """Acceleration of the rope exits that sets waves going, m/s², block by block, shape (BLOCK, 2)."""
        waves = self._scenario.suspension.waves
        return self._noise(low_pass(waves.bandwidth_hz), waves.exit_rms_m_s2, "waves")

    def _noise(self, shape: Shape | None, rms: float, name: str) -> Iterator[Array]:
        """Blocks (BLOCK, 2) of two independent components, each of this rms."""
        if not shape or not rms:
            return itertools.repeat(np.zeros((BLOCK, 2)))
        pair = (
            noise(shape, self.interval, seed=self._scenario.seed, clip=self._clip, name=f"{name}.{axis}")
            for axis in "xy"
        )
        return (rms * np.stack(blocks, axis=-1) for blocks in zip(*pair, strict=True))


def _velocity(radius: float, course: Course) -> Array:
    """Velocity of O over the ground, shape (n, 2), in axes that do not turn, m/s."""
    out = np.stack([np.cos(course.slew), np.sin(course.slew)], axis=-1)
    around = np.stack([-out[:, 1], out[:, 0]], axis=-1)
    return np.asarray(course.luff_rate[:, None] * out + ((radius + course.luffed) * course.slew_rate)[:, None] * around)


def _begin(start: Start, mass: Mass, rope: float) -> tuple[Array, Array]:
    """Attitude (quaternion) and angular velocity (grab frame, rad/s) in which a clip begins."""
    alpha, azimuth, yaw = np.radians((start.alpha_deg, start.azimuth_deg, start.yaw_deg))
    half = alpha / 2
    leaning = np.array([np.cos(half), np.sin(half) * np.sin(azimuth), -np.sin(half) * np.cos(azimuth), 0.0])
    w, x, y, _ = leaning
    c, s = np.cos(yaw / 2), np.sin(yaw / 2)
    attitude = np.array([w * c, x * c + y * s, y * c - x * s, w * s])
    arm = rope - mass.centre_z
    frequency = math.sqrt(mass.mass * STANDARD_GRAVITY * arm / (mass.inertia[0] + mass.mass * arm**2))
    along = geometry.grab_centre(alpha, azimuth, 1.0)
    sideways = start.roundness * alpha * frequency * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = geometry.grab_rotation(alpha, azimuth, yaw)
    return attitude, np.asarray(rotation.T @ np.cross(along, sideways))

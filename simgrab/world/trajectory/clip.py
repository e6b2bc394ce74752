"""A clip's moments, one after another, in bounded memory."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.model.scenario import Dynamic, OneBody, Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.trajectory.display import Shown, shown
from simgrab.world.trajectory.linked import LinkedPlant
from simgrab.world.trajectory.moment import JibState, Moment
from simgrab.world.trajectory.mount import Mount, tilted
from simgrab.world.trajectory.noise import BLOCK, ShapingFilter, low_pass, narrow_band, noise, von_karman
from simgrab.world.trajectory.one_body import OneBodyPlant
from simgrab.world.trajectory.plant import MOST_STEP_S, Drive, Plant, turned
from simgrab.world.trajectory.work import Course, Work

MOST_INTERVAL_S = 0.02  # between changes of what acts on the grab


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """The inputs that drive a clip during `BLOCK` intervals. Vectors are in axes that do not turn, unless stated."""

    count: int  # number of the first interval; interval 0 begins with the first frame
    interval: float  # s
    course: Course  # course at both ends of all intervals, one instant more than intervals
    gravity: Array  # (BLOCK, 3), less O's mean acceleration, m/s²
    velocity: Array  # (BLOCK + 1, 2), velocity of O, at the intervals' ends, m/s
    felt: Array  # (BLOCK, 3), `gravity` in the jib frame of the interval's beginning
    wind: Array  # (BLOCK, 2), m/s
    push: Array  # (BLOCK, 2), m/s²
    shake: Array  # (BLOCK, 2), lean of the jib head from vibration at the intervals' beginnings, jib frame, rad
    lean: Array  # (BLOCK + 1, 2, 2), lean of the camera's mount and its rate, at the intervals' ends; see `Mount`

    def drives(self) -> Iterator[Drive]:
        """Yield the drive of the grab in each interval."""
        course = self.course
        columns = (
            self.gravity, self.velocity[:-1], (course.slew[:-1] + course.slew[1:]) / 2, course.rope[:-1],
            course.rope_rate[:-1], np.diff(course.rope_rate) / self.interval, self.wind, self.push, course.held[:-1],
            course.jaw[:-1], course.load[:-1],
        )  # fmt: skip
        return itertools.starmap(Drive, zip(*(column.tolist() for column in columns), strict=True))


class ClipMotion:
    """One clip of a scenario with dynamic swing; each clip has its own draws.

    Iterate over it for its `Moment`s, from the first frame on, without end.
    """

    def __init__(self, scenario: Scenario, clip: int) -> None:
        assert isinstance(scenario.swing, Dynamic)
        self._scenario, self._swing, self._clip = scenario, scenario.swing, clip
        period = 1 / scenario.clip.frame_rate_hz
        self._per_frame = math.ceil(period / MOST_INTERVAL_S)
        self.interval = period / self._per_frame
        self.steps = math.ceil(self.interval / MOST_STEP_S)
        self._warm_up_frames = math.ceil(self._swing.settle_s / period)  # before the first
        self._first = scenario.span(clip).start  # frame
        self._layout = scenario.display_layout

    def __iter__(self) -> Iterator[Moment]:
        work, plant = Work(self._scenario, self._clip), None
        for block in self.blocks(work):
            for i, drive in enumerate(block.drives()):
                plant = plant or self.plant(drive)
                count, moment = block.count + i, None
                if count >= 0 and count % self._per_frame == 0:
                    moment = self._moment(count / self._per_frame, plant, block, i)
                    if self._layout:
                        moment = dataclasses.replace(moment, shown=self._shown(moment, work))
                plant.run(drive, self.interval, self.steps)
                if moment:
                    if self._scenario.shutter.open_s > 0:
                        ahead = self._moment((count + 1) / self._per_frame, plant, block, i + 1)
                        moment = dataclasses.replace(moment, ahead=ahead)
                    yield moment

    @property
    def warm_up_s(self) -> float:
        """Simulated time before the first frame, s. The work's clock is ahead of the clip's by this time."""
        return self._warm_up_frames * self._per_frame * self.interval

    def blocks(self, work: Work) -> Iterator[Block]:
        """Yield the clip's drives, block by block, without end; ``work`` is sampled as blocks are requested."""
        noises = zip(self._wind(), self._forcing(), self._vibration(), strict=True)
        mount = Mount(self._scenario.camera, self.interval)
        for block, (wind, push, shake) in enumerate(noises):
            # One instant more than intervals: each takes its mean accelerations from both its ends.
            ticks = np.arange(block * BLOCK, (block + 1) * BLOCK + 1, dtype=float)
            course = work.sample(self.interval * ticks)
            velocity = _velocity(self._swing.radius_m, course)
            gravity = np.full((BLOCK, 3), -STANDARD_GRAVITY)
            gravity[:, :2] = -np.diff(velocity, axis=0) / self.interval
            count = block * BLOCK - self._warm_up_frames * self._per_frame
            felt = turned(gravity, -course.slew[:-1])
            lean = mount.advance(felt, course.luffed)
            yield Block(count, self.interval, course, gravity, velocity, felt, wind, push, shake, lean)

    def plant(self, drive: Drive) -> Plant:
        """Make the grab as the clip begins."""
        kind = OneBodyPlant if isinstance(self._scenario.suspension, OneBody) else LinkedPlant
        return kind(self._scenario, drive)

    def _moment(self, index: float, plant: Plant, block: Block, i: int) -> Moment:
        """Moment at the beginning of the block's i-th interval, or the end of its last."""
        course, now = block.course, min(i, BLOCK - 1)  # the next block's tremble and pull are not drawn yet
        slew, luffed = float(course.slew[i]), float(course.luffed[i])
        x, y, z = block.felt[now].tolist()
        still = Moment.still(
            self._first + int(index), plant.grab_state(slew, float(course.jaw[i]), float(course.load[i])),
            tilted(self._scenario.camera, block.lean[i, 0] + block.shake[now]),
        )  # fmt: skip
        return dataclasses.replace(
            still, clip=self._clip, time=index / self._scenario.clip.frame_rate_hz,
            jib=JibState(slew, self._swing.radius_m + luffed, luffed), apparent_gravity=(x, y, z),
        )  # fmt: skip

    def _shown(self, moment: Moment, work: Work) -> Shown:
        """Compute the display's text; its clock continues from clip to clip."""
        assert self._layout is not None
        rate, grab = self._scenario.clip.frame_rate_hz, design_of(self._scenario.grab)

        def lengths(time: float) -> tuple[float, float]:
            rope, jaw = work.rope_and_jaw(max(time - self._first / rate + self.warm_up_s, 0.0))
            return rope, rope + grab.closing_rope_m(jaw)

        return shown(self._scenario.display, self._layout, moment.frame / rate, lengths)

    def _wind(self) -> Iterator[Array]:
        wind = self._swing.wind
        along = np.array([math.cos(math.radians(wind.azimuth_deg)), math.sin(math.radians(wind.azimuth_deg))])
        mean = wind.mean_m_s * along
        turn = np.column_stack([along, (-along[1], along[0])])
        gusts = wind.mean_m_s * wind.intensity
        shape = von_karman(wind.scale_m, wind.mean_m_s) if gusts else None
        return (mean + block @ turn.T for block in self.noise(shape, gusts, "wind"))

    def _forcing(self) -> Iterator[Array]:
        forcing = self._swing.forcing
        return self.noise(low_pass(forcing.bandwidth_hz), forcing.rms_m_s2, "forcing")

    def _vibration(self) -> Iterator[Array]:
        vibration = self._scenario.camera.mount.vibration
        shape = narrow_band(vibration.frequency_hz, vibration.damping)
        return self.noise(shape, math.radians(vibration.rms_deg), "vibration")

    def noise(self, shape: ShapingFilter | None, rms: float, name: str) -> Iterator[Array]:
        """Blocks (BLOCK, 2) of two independent components with this rms each."""
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

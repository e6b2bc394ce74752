"""Everything that moves, at one instant."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace

from scipy.spatial.transform import Rotation

from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY, Array, Pose
from simgrab.model.scenario import Camera, Clampable
from simgrab.world.trajectory.display import Shown

STRAIGHT = 1e-12  # sine of a tilt so small that it has no azimuth


@dataclass(frozen=True)
class GrabState:
    """Pose of the grab in the jib frame, rad and m, and its fill.

    Attributes
    ----------
    alpha, azimuth : float
        Swing angle, and its azimuth in the jib frame.
    rope_length : float
        |OA|.
    yaw, jaw : float
        Turn about the rope; opening of each shell.
    load : float
        Fill, 0 to 1.
    head : tuple of 2 floats, or None
        Angle between the grab's own axis and gravity, and its azimuth; None if the axis is along OA.
    """

    alpha: float
    azimuth: float
    rope_length: float
    yaw: float
    jaw: float
    load: float
    head: tuple[float, float] | None = None

    @property
    def jib_from_grab(self) -> Pose:
        """Pose of the grab, whose axis leans as its head does."""
        return Pose(
            geometry.grab_rotation(*(self.head or (self.alpha, self.azimuth)), self.yaw),
            geometry.grab_centre(self.alpha, self.azimuth, self.rope_length),
        )


@dataclass(frozen=True)
class Tilt:
    """Attitude of the camera in the jib frame, rad: β, tilt azimuth and roll."""

    beta: float
    azimuth: float
    roll: float

    @property
    def jib_from_camera(self) -> Array:
        """Rotation, shape (3, 3)."""
        return geometry.camera_rotation(self.beta, self.azimuth, self.roll)

    @classmethod
    def at_rest(cls, camera: Camera) -> Tilt:
        """Attitude of the camera in the scenario."""
        return cls(*(math.radians(a) for a in (camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg)))

    @classmethod
    def of(cls, rotation: Array, azimuth: float) -> Tilt:
        """Read a rotation ``jib_from_camera``, shape (3, 3); ``azimuth`` is used if the camera hangs straight."""
        axis = rotation[:, 2]
        across = math.hypot(axis[0], axis[1])
        if across > STRAIGHT:
            azimuth = math.atan2(axis[1], axis[0])
        beta = math.atan2(across, -axis[2])
        turn = geometry.camera_rotation(beta, azimuth, 0.0).T @ rotation
        return cls(beta, azimuth % (2 * math.pi), math.atan2(turn[1, 0], turn[0, 0]))


@dataclass(frozen=True)
class JibState:
    """Position of the jib over the place.

    Attributes
    ----------
    slew : float
        Slewing angle, counter-clockwise from above, rad; 0 where O is above the middle of the place.
    radius : float
        From the slewing axis to O, m.
    luffed : float
        Growth of the radius, m.
    """

    slew: float
    radius: float
    luffed: float

    @property
    def jib_from_place(self) -> Pose:
        """Pose of the place's frame, which is the jib frame before slewing and luffing."""
        turn = geometry.rotation_z(-self.slew)
        return Pose(turn, turn @ (self.radius - self.luffed, 0.0, 0.0) - (self.radius, 0.0, 0.0))


@dataclass(frozen=True)
class Moment:
    """One frame's instant.

    Attributes
    ----------
    frame : int
    grab : GrabState
    tilt : Tilt
    gamma : float
        Azimuth of the swing less the tilt azimuth, rad, in [0, 2π).
    present : bool
        Whether the grab is present; if not, ``grab`` is the pose it would have.
    clip : int or None
        None for independent frames, like `time` and `jib`.
    time : float or None
        Since the clip began, s.
    jib : JibState or None
    apparent_gravity : tuple of 3 floats
        Gravity less the acceleration of O, jib frame, m/s².
    shown : Shown or None
        Text of the display; None without a display.
    ahead : Moment or None
        A moment shortly after, for motion blur; None if nothing moves.
    clamped : tuple of str
        Keys of the swing whose draw was impossible and was replaced by the nearest possible value.
    """

    frame: int
    grab: GrabState
    tilt: Tilt
    gamma: float
    present: bool = True
    clip: int | None = None
    time: float | None = None
    jib: JibState | None = None
    apparent_gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    shown: Shown | None = None
    ahead: Moment | None = None
    clamped: tuple[Clampable, ...] = ()

    @classmethod
    def still(cls, frame: int, grab: GrabState, tilt: Tilt) -> Moment:
        """Moment of an independent frame, in which nothing moves."""
        return cls(frame, grab, tilt, (grab.azimuth - tilt.azimuth) % (2 * math.pi))

    def shifted(self, seconds: float) -> Moment:
        """Interpolate towards the moment ahead, by some tens of milliseconds; without one, stay."""
        if self.ahead is None or not seconds:
            return self
        assert self.time is not None
        assert self.ahead.time is not None
        assert self.jib is not None
        assert self.ahead.jib is not None
        share = seconds / (self.ahead.time - self.time)
        here, there = self.grab, self.ahead.grab

        def between(a: float, b: float) -> float:
            return a + share * (b - a)

        start, end = here.jib_from_grab.translation, there.jib_from_grab.translation
        alpha, azimuth, rope = geometry.swing_of(start + share * (end - start))
        grab = GrabState(
            float(alpha), float(azimuth), float(rope),
            yaw=float(geometry.wrap(here.yaw + share * float(geometry.wrap(there.yaw - here.yaw)))),
            jaw=max(between(here.jaw, there.jaw), 0.0),
            load=here.load,
            head=_lean_between(here.head, there.head, share),
        )  # fmt: skip
        first = Rotation.from_matrix(self.tilt.jib_from_camera)
        turn = (first.inv() * Rotation.from_matrix(self.ahead.tilt.jib_from_camera)).as_rotvec()
        tilt = Tilt.of((first * Rotation.from_rotvec(share * turn)).as_matrix(), self.tilt.azimuth)
        jib = JibState(*(between(a, b) for a, b in zip(astuple(self.jib), astuple(self.ahead.jib), strict=True)))
        gamma = (grab.azimuth - tilt.azimuth) % (2 * math.pi)
        return replace(self, grab=grab, tilt=tilt, jib=jib, gamma=gamma, time=self.time + seconds)


def _lean_between(
    here: tuple[float, float] | None, there: tuple[float, float] | None, share: float
) -> tuple[float, float] | None:
    """Lean of a head part of the way between two, by its horizontal components."""
    if here is None or there is None:
        return None
    (x0, y0), (x1, y1) = ((lean * math.cos(azimuth), lean * math.sin(azimuth)) for lean, azimuth in (here, there))
    x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    return math.hypot(x, y), math.atan2(y, x) % (2 * math.pi)

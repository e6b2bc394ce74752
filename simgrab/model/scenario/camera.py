"""The camera: lens, tilt, place, and what it hangs on."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.geometry import PAPER_FOCAL_LENGTH_MM, PAPER_PIXELS_PER_MM, Distortion, Intrinsics, pixels_per_mm
from simgrab.model.scenario.base import Azimuth, Meta, Strict, Tagged, about

Shift = Annotated[float, Meta(ge=-100_000, le=100_000)]
Shifts = tuple[Shift, Shift]


class PixelFocal(Tagged, frozen=True, tag="pixels"):
    """Focal length given in pixels."""

    focal_length_px: Annotated[float, about("Focal length in pixels.", ge=100, le=100_000)]

    def pixels(self, width_px: int, height_px: int) -> float:  # noqa: ARG002
        """Focal length h, px."""
        return self.focal_length_px


class LensFocal(Tagged, frozen=True, tag="lens"):
    """Lens and pixel density; the defaults are the paper's camera, h = 1644.82 px (section 4.3)."""

    focal_length_mm: Annotated[float, about("Focal length of the lens.", ge=0.5, le=500)] = PAPER_FOCAL_LENGTH_MM
    pixels_per_mm: Annotated[float, about("Pixel density of the sensor.", ge=10, le=5000)] = PAPER_PIXELS_PER_MM

    def pixels(self, width_px: int, height_px: int) -> float:  # noqa: ARG002
        """Focal length h, px."""
        return self.focal_length_mm * self.pixels_per_mm


class SensorFocal(Tagged, frozen=True, tag="sensor"):
    """Lens and sensor diagonal, the sensor being read out whole."""

    focal_length_mm: Annotated[float, about("Focal length of the lens.", ge=0.5, le=500)] = PAPER_FOCAL_LENGTH_MM
    sensor_diagonal_mm: Annotated[float, about("Diagonal of the sensor, which is read out whole.", ge=1, le=100)] = 6.43

    def pixels(self, width_px: int, height_px: int) -> float:
        """Focal length h, px."""
        return self.focal_length_mm * pixels_per_mm(width_px, height_px, self.sensor_diagonal_mm)


class Lens(Strict, frozen=True):
    """Brown–Conrady coefficients, OpenCV's order and signs."""

    k1: Annotated[float, about("First radial coefficient.", ge=-1, le=1)] = 0.0
    k2: Annotated[float, about("Second radial coefficient.", ge=-1, le=1)] = 0.0
    p1: Annotated[float, about("First tangential coefficient.", ge=-0.1, le=0.1)] = 0.0
    p2: Annotated[float, about("Second tangential coefficient.", ge=-0.1, le=0.1)] = 0.0
    k3: Annotated[float, about("Third radial coefficient.", ge=-1, le=1)] = 0.0


class Vibration(Strict, frozen=True):
    """Trembling of the jib head: each component of the tilt wanders in a narrow band about a frequency."""

    rms_deg: Annotated[float, about("RMS of each component of the tilt.", ge=0, le=2)] = 0.0
    frequency_hz: Annotated[float, about("Centre of its narrow band.", ge=0.05, le=10)] = 0.6
    damping: Annotated[float, about("Width of the band, as a share of critical damping.", gt=0, le=1)] = 0.1


class FixedMount(Tagged, frozen=True, tag="fixed"):
    """The tilt stays what it is, by decree."""

    vibration: Annotated[Vibration, about("Random vibration of the camera, added to its tilt.")] = Vibration()


class LevelledMount(Tagged, frozen=True, tag="levelled"):
    """The camera hangs by gravity, damped, ``beta_deg`` off plumb: it follows what the moving jib feels as gravity."""

    frequency_hz: Annotated[float, about("Natural frequency of the suspended camera.", ge=0.05, le=10)] = 0.5
    damping: Annotated[float, about("Share of critical damping.", gt=0, le=5)] = 0.5
    vibration: Annotated[Vibration, about("Random vibration of the camera, added to its tilt.")] = Vibration()


class RigidMount(Tagged, frozen=True, tag="rigid"):
    """Bolted to the fly-jib, whose pitch follows luffing; ``beta_deg`` holds at the radius where the clip begins."""

    pitch_deg_per_m: Annotated[float, about("Pitch of the camera per metre of luffing.", ge=-10, le=10)] = 2.0
    vibration: Annotated[Vibration, about("Random vibration of the camera, added to its tilt.")] = Vibration()


class Camera(Strict, frozen=True):
    """The surveillance camera at the jib head: the truth, which the instrument never gets."""

    width_px: Annotated[int, about("Width of the image.", ge=64, le=4096)] = 1920
    height_px: Annotated[int, about("Height of the image.", ge=64, le=4096)] = 1080
    focal: Annotated[PixelFocal | LensFocal | SensorFocal, about("Focal length, in one of three ways.")] = LensFocal()
    principal_offset_px: Annotated[Shifts, about("Principal point minus image centre, right and down.")] = (0.0, 0.0)
    distortion: Annotated[Lens, about("Lens distortion, Brown–Conrady in OpenCV's order and signs.")] = Lens()
    beta_deg: Annotated[float, about("Tilt β: the angle between optical axis and gravity.", ge=0, le=30)] = 3.0
    tilt_azimuth_deg: Annotated[Azimuth, about("Azimuth of the tilt, from outboard.")] = 0.0
    roll_deg: Annotated[
        float, about("Turn about the optical axis; positive: outboard is left of the top.", ge=-180, le=180)
    ] = 0.0
    offset_x_m: Annotated[float, about("Camera centre minus rope exit O, outboard.", ge=-3, le=3)] = 0.0
    offset_y_m: Annotated[float, about("Camera centre minus rope exit O, along y of the jib frame.", ge=-3, le=3)] = 0.6
    offset_z_m: Annotated[float, about("Camera centre minus rope exit O, upwards.", ge=-3, le=1)] = -0.3
    mount: Annotated[LevelledMount | RigidMount | FixedMount, about("How the camera is mounted.")] = LevelledMount()

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole and its lens."""
        d = self.distortion
        return Intrinsics(
            self.width_px,
            self.height_px,
            self.focal.pixels(self.width_px, self.height_px),
            self.width_px / 2 + self.principal_offset_px[0],
            self.height_px / 2 + self.principal_offset_px[1],
            Distortion(d.k1, d.k2, d.p1, d.p2, d.k3),
        )

    @property
    def offset_m(self) -> tuple[float, float, float]:
        """Camera centre minus O, jib frame, m."""
        return self.offset_x_m, self.offset_y_m, self.offset_z_m

"""Cameras and sensors by name, and what their data sheets say of the lens: for `simgrab new`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

# Pictures in pixels, and by the lens's focal length in mm the horizontal and vertical field of view in degrees, from a
# public transcription of the makers' data sheets (October 2026), which was not compared with the sheets themselves.
CAMERAS: Mapping[str, tuple[int, int, Mapping[float, tuple[float, float]]]] = {
    "Hikvision DS-2CD1023G2-LIU": (1920, 1080, {2.8: (103, 56), 4: (83, 44)}),
    "Hikvision DS-2CD1043G2-LIU": (2560, 1440, {2.8: (98, 54), 4: (78, 42)}),
    "Hikvision DS-2CD2143G2-I": (2688, 1520, {2.8: (103, 55), 4: (84, 45)}),
    "Hikvision DS-2CD2387G2-LSU": (3840, 2160, {2.8: (102, 52), 4: (88, 47)}),
    "Hikvision DS-2CD2T47G2-L": (2688, 1520, {4: (95, 51), 6: (58, 31)}),
    "Dahua IPC-HDBW2441E-S": (2688, 1520, {2.8: (102, 54), 3.6: (84, 42)}),
    "Dahua IPC-HFW1230S-S5": (1920, 1080, {2.8: (102, 54), 3.6: (84, 45)}),
    "Dahua IPC-HFW1430DT-STW": (2560, 1440, {2.8: (90, 50), 3.6: (76, 40)}),
    "Dahua IPC-HFW2441S-S": (2688, 1520, {2.8: (95, 52), 3.6: (78, 41)}),
    "AXIS M2035-LE": (1920, 1080, {3.2: (101, 54), 7.5: (39, 22)}),
    "AXIS M3085-V": (1920, 1080, {3.1: (102, 55)}),
}
# Format in inches, pixel pitch in µm and active pixels: nominal values of sensors by Sony, OmniVision and onsemi.
SENSORS: Mapping[str, tuple[str, float, int, int]] = {
    "OV9712": ("1/4", 3.0, 1280, 800),
    "AR0130": ("1/3", 3.75, 1280, 960),
    "AR0330": ("1/3", 2.2, 2304, 1536),
    "OV4689": ("1/3", 2.0, 2688, 1520),
    "IMX323": ("1/2.9", 2.8, 1920, 1080),
    "IMX290, IMX307, IMX327": ("1/2.8", 2.9, 1920, 1080),
    "IMX335": ("1/2.8", 2.0, 2592, 1944),
    "IMX415": ("1/2.8", 1.45, 3840, 2160),
    "OV2710": ("1/2.7", 3.0, 1920, 1080),
    "AR0521": ("1/2.5", 2.2, 2592, 1944),
    "IMX385": ("1/2", 3.75, 1920, 1080),
    "IMX178": ("1/1.8", 2.4, 3072, 2048),
    "IMX334": ("1/1.8", 2.0, 3840, 2160),
    "IMX347": ("1/1.8", 2.9, 2688, 1520),
    "IMX485, IMX585": ("1/1.2", 2.9, 3840, 2160),
}
BARREL = 0.84
"""Median of the barrel distortion of the lenses in `CAMERAS`."""
BARRELS = (BARREL, 0.6, 0.4, 0.2)
"""Distortions to assume, the first of which fits: short lenses on large sensors have less."""
MOST_BARREL = 1.2


def sensor(text: str, width_px: int, height_px: int) -> tuple[str, bool]:
    """Find a sensor by name, or the one of a format that is most like a picture of that size, and whether by format.

    Raises ValueError.
    """
    wanted = text.strip(' "″”').upper()
    found = [one for one, (size, *_) in SENSORS.items() if wanted in (*one.split(", "), size)]
    if not found:
        formats = dict.fromkeys(size for size, *_ in SENSORS.values())
        raise ValueError(f"must be one of {', '.join(formats)}, {', '.join(SENSORS)}; got {text!r}; or give --fov")

    def unlike(one: str) -> tuple[float, float]:
        _, _, wide, high = SENSORS[one]
        return abs(math.log(wide / high * height_px / width_px)), abs(math.log(wide / width_px))

    return min(found, key=unlike), wanted == SENSORS[found[0]][0]


def barrel(width_px: int, height_px: int, across_deg: float, up_deg: float) -> float:
    """Barrel distortion c of a lens from its horizontal and vertical field of view.

    The lens images a ray at the angle θ from the axis at the radius f·t/√(1 + c·t²), t = tan θ: with c = 0 as a
    pinhole, with c = 1 as f·sin θ. So cot²(across/2) + c is (f/R)² with half the width as R, and alike up.

    Raises `ValueError` if no such lens gives both angles.
    """
    ratio = (width_px / height_px) ** 2
    if ratio == 1:
        return BARREL
    value = (_cot2(up_deg) - ratio * _cot2(across_deg)) / (ratio - 1)
    ends = [vertical_deg(width_px, height_px, across_deg, end) for end in (0.0, MOST_BARREL)]
    if not min(ends) - 2 <= up_deg <= max(ends) + 2:  # data sheets round
        raise ValueError(
            f"{across_deg:g}° across and {up_deg:g}° up do not fit a picture of {width_px}x{height_px} px, "
            f"where {across_deg:g}° across goes with {min(ends):.0f}° to {max(ends):.0f}° up"
        )
    return min(max(value, 0.0), MOST_BARREL)


def vertical_deg(width_px: int, height_px: int, across_deg: float, c: float) -> float:
    """Vertical field of view of a lens of a horizontal one, degrees."""
    return 2 * math.degrees(math.atan((max((width_px / height_px) ** 2 * (_cot2(across_deg) + c) - c, 1e-9)) ** -0.5))


def focal_px(width_px: int, across_deg: float, c: float) -> float:
    """Focal length in the middle of the picture, px."""
    return width_px / 2 * math.sqrt(_cot2(across_deg) + c)


def across_deg(width_px: int, f_px: float, c: float) -> float:
    """Horizontal field of view of a lens, degrees; raises ValueError where the lens does not reach so far."""
    return 2 * math.degrees(math.atan(_tangent(width_px / 2 / f_px, c)))


def brown(width_px: int, height_px: int, f_px: float, c: float) -> tuple[float, float, float]:
    """Give k1, k2, k3 of the Brown–Conrady lens next to the lens c, with the same horizontal field of view.

    It maps all rays up to 3 % beyond the picture's corners, and folds nowhere there.

    Raises `ValueError` if the picture is too wide for such a lens.
    """
    import numpy as np
    from scipy.optimize import linprog

    from simgrab.model.geometry import Distortion

    edge, corner = width_px / 2 / f_px, 1.03 * math.hypot(width_px, height_px) / 2 / f_px
    across, most = _tangent(edge, c), 1.02 * _tangent(corner, c)
    t = np.linspace(0, most, 61)[1:]
    powers, ones = np.stack([t**2, t**4, t**6], 1), np.ones((60, 1))
    off = 1 / np.sqrt(1 + c * t**2) - 1
    slope = powers * [3, 5, 7]
    reach = [-(most**3), -(most**5), -(most**7), 0]
    solved = linprog(  # least largest deviation, the 4th variable; rising; reaching the corner; exact at the edge
        [0, 0, 0, 1],
        np.vstack([np.hstack([powers, -ones]), np.hstack([-powers, -ones]), np.hstack([-slope, 0 * ones]), reach]),
        np.concatenate([off, -off, np.full(60, 0.98), [most - corner]]),
        [[across**2, across**4, across**6, 0]],
        [edge / across - 1],
        bounds=[(-1, 1)] * 3 + [(0, 0.1)],
    )
    if not solved.success:
        raise ValueError(_TOO_WIDE)
    k1, k2, k3 = (round(float(k), 6) for k in solved.x[:3])
    ends = np.outer([1, 1.011], [width_px, height_px]) / 2 / f_px  # of focal lengths down to 99 %, too
    if np.isnan(Distortion(k1, k2, k3=k3).remove(ends)).any():
        raise ValueError(_TOO_WIDE)
    return k1, k2, k3


def first_fitting(
    width_px: int, height_px: int, barrels: Sequence[float], focal: Callable[[float], float]
) -> tuple[float, float, tuple[float, float, float]]:
    """Return the first barrel distortion that a scene can have, the focal length in px that goes with it, and `brown`.

    Raises `ValueError` if the lens is too wide with each.
    """
    *others, last = barrels
    for c in others:
        with suppress(ValueError):
            return c, focal(c), brown(width_px, height_px, focal(c), c)
    return last, focal(last), brown(width_px, height_px, focal(last), last)


_TOO_WIDE = "the lens is too wide for the scene's model of distortion: choose a longer lens or a narrower field of view"


def _tangent(radius: float, c: float) -> float:
    """Tangent of the angle that is imaged at a radius, over the focal length."""
    if c * radius**2 > 0.95:
        raise ValueError(_TOO_WIDE)
    return radius / math.sqrt(1 - c * radius**2)


def _cot2(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg) / 2) ** -2

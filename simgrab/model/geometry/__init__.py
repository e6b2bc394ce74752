"""The geometry of Yu, Wang & Wang (2025): rays, the tilted camera, and the swing angles they see.

Frames. The *jib frame* has its origin O at the rope exit, x horizontal and outboard, z up. The *camera frame* is
OpenCV's: x right, y down, z forward. Angles are radians, lengths metres, pixels continuous: (0, 0) is the outer corner
of the top-left pixel and pixel centres lie at +0.5. Everything is float64 and broadcasts over leading axes (frames).
"""

from simgrab.model.geometry.lens import Distortion, Intrinsics, pixels_per_mm
from simgrab.model.geometry.paper import (
    PAPER_FOCAL_LENGTH_MM,
    PAPER_PIXELS_PER_MM,
    eq1_residual,
    eq2_cos_alpha,
    image_radius,
)
from simgrab.model.geometry.pose import Pose
from simgrab.model.geometry.rotations import (
    STANDARD_GRAVITY,
    Array,
    camera_rotation,
    grab_centre,
    grab_rotation,
    lean,
    on_ropes,
    rotation_y,
    rotation_z,
    swing_of,
    to_camera,
    vertical_direction,
    wrap,
)

__all__ = [
    "PAPER_FOCAL_LENGTH_MM",
    "PAPER_PIXELS_PER_MM",
    "STANDARD_GRAVITY",
    "Array",
    "Distortion",
    "Intrinsics",
    "Pose",
    "camera_rotation",
    "eq1_residual",
    "eq2_cos_alpha",
    "grab_centre",
    "grab_rotation",
    "image_radius",
    "lean",
    "on_ropes",
    "pixels_per_mm",
    "rotation_y",
    "rotation_z",
    "swing_of",
    "to_camera",
    "vertical_direction",
    "wrap",
]

"""The geometry of Yu, Wang & Wang (2025): rays, the tilted camera, and the swing angles they see.

Frames. The *jib frame* has its origin O at the rope exit, x horizontal and outboard, z up. The *camera frame* is
OpenCV's: x right, y down, z forward. Angles are radians, lengths metres, pixels continuous: (0, 0) is the outer corner
of the top-left pixel and pixel centres lie at +0.5. Everything is float64 and broadcasts over leading axes (frames).
"""

from simgrab.model.geometry.lens import Distortion as Distortion
from simgrab.model.geometry.lens import Intrinsics as Intrinsics
from simgrab.model.geometry.lens import pixels_per_mm as pixels_per_mm
from simgrab.model.geometry.paper import PAPER_FOCAL_LENGTH_MM as PAPER_FOCAL_LENGTH_MM
from simgrab.model.geometry.paper import PAPER_PIXELS_PER_MM as PAPER_PIXELS_PER_MM
from simgrab.model.geometry.paper import image_radius as image_radius
from simgrab.model.geometry.pose import Pose as Pose
from simgrab.model.geometry.rotations import STANDARD_GRAVITY as STANDARD_GRAVITY
from simgrab.model.geometry.rotations import Array as Array
from simgrab.model.geometry.rotations import camera_rotation as camera_rotation
from simgrab.model.geometry.rotations import grab_centre as grab_centre
from simgrab.model.geometry.rotations import grab_rotation as grab_rotation
from simgrab.model.geometry.rotations import lean as lean
from simgrab.model.geometry.rotations import on_ropes as on_ropes
from simgrab.model.geometry.rotations import rotation_z as rotation_z
from simgrab.model.geometry.rotations import swing_of as swing_of
from simgrab.model.geometry.rotations import to_camera as to_camera
from simgrab.model.geometry.rotations import vertical_direction as vertical_direction
from simgrab.model.geometry.rotations import wrap as wrap

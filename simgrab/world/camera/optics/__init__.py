"""The optics and the sensor: what becomes of the light between the scene and the picture."""

from simgrab.world.camera.optics.chain import expose, recompress
from simgrab.world.camera.optics.exposure import Exposure, metered
from simgrab.world.camera.optics.light import Light, Picture, to_display, to_linear

__all__ = ["Exposure", "Light", "Picture", "expose", "metered", "recompress", "to_display", "to_linear"]

"""The optics and the sensor: what becomes of the light between the scene and the picture."""

from simgrab.world.optics.chain import expose
from simgrab.world.optics.exposure import Exposure, ExposureControl, settled
from simgrab.world.optics.light import Light, Picture, to_display, to_linear
from simgrab.world.optics.recompress import recompress

__all__ = [
    "Exposure",
    "ExposureControl",
    "Light",
    "Picture",
    "expose",
    "recompress",
    "settled",
    "to_display",
    "to_linear",
]

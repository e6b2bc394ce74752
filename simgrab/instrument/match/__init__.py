"""What a camera's own footage shows of the camera: size, coder, noise, blur, shading, display and grab.

Pixels alone come in. Each result has a 95 % interval, or the reason why the footage does not determine it.
"""

from simgrab.instrument.match.appearance import Appearance, measure
from simgrab.instrument.match.footage import Footage, read
from simgrab.instrument.match.quantity import Quantity, unknown

__all__ = ["Appearance", "Footage", "Quantity", "measure", "read", "unknown"]

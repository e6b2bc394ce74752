"""What a camera's own footage shows of the camera: size, coder, noise, blur, shading, display and grab.

Pixels alone come in. Each result has a 95 % interval, or the reason why the footage does not determine it.
"""

from simgrab.match.footage.appearance import Appearance, measure
from simgrab.match.footage.footage import Footage, read
from simgrab.match.footage.quantity import Quantity

__all__ = ["Appearance", "Footage", "Quantity", "measure", "read"]

"""What a camera's own footage shows of the camera: size, coder, noise, blur, shading, display and grab.

Pixels alone come in. Each result has a 95 % interval, or the reason why the footage does not determine it.
"""

from simgrab.instrument.match.footage import Footage, read
from simgrab.instrument.match.look import Look, look
from simgrab.instrument.match.quantity import Quantity, unknown

__all__ = ["Footage", "Look", "Quantity", "look", "read", "unknown"]

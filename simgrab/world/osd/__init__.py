"""The on-screen display: what it shows at a moment, and how that is blended into the picture."""

from simgrab.world.osd.draw import Overlay
from simgrab.world.osd.shown import Shown, shown

__all__ = ["Overlay", "Shown", "shown"]

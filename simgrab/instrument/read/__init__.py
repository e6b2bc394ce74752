"""Rope lengths from the on-screen display: digits at fixed pixels, read by LeNet-5, and checked against the hoist."""

from simgrab.instrument.read.consistency import Hoist, checked, consistent
from simgrab.instrument.read.reader import BUNDLED, Reader

__all__ = ["BUNDLED", "Hoist", "Reader", "checked", "consistent"]

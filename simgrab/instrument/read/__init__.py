"""Rope lengths from the on-screen display: digits at fixed pixels, read by LeNet-5, and checked against the hoist."""

from simgrab.instrument.read.consistency import Hoist, consistent
from simgrab.instrument.read.reader import READER_WEIGHTS, Reader

__all__ = ["READER_WEIGHTS", "Hoist", "Reader", "consistent"]

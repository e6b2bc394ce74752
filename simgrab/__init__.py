"""simgrab: frames of a swinging crane grab in which the swing is known because it was set."""

__version__ = "0.1.0"

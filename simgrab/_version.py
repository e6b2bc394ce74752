"""The version, apart from the package's front door, which imports every room when asked."""

__version__ = "0.1.0"

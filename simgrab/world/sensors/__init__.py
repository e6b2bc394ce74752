"""Sensors beside the camera: true values at their mounts, and their readings."""

"""Sensors beside the camera that only rival methods use."""

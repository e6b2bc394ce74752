"""Sensors beside the camera: what they would measure exactly, and what they report."""

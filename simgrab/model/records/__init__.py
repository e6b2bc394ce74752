"""Frozen values that the instrument returns: detections, readings and estimates."""

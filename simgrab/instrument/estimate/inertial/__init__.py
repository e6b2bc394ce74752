"""Swing from pictures and one inertial sensor in the camera's housing."""

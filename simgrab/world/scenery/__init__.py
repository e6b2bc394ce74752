"""Builds places, the grab and the jib head, and their MuJoCo model."""

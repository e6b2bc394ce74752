"""Shapes, built with trimesh: every one a set of watertight parts in metres."""

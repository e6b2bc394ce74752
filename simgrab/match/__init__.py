"""Writes a scene from footage of a camera, or from what is known of it."""

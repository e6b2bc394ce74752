"""Writes a scene that resembles footage."""

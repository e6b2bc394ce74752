"""Clips as H.264 videos, each with a table of what it shows and when."""

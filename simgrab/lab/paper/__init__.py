"""Repeats the paper's own experiments."""

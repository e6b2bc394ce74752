"""Compares measurements with the truth."""

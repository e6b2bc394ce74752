"""Compares a run with the truth."""

"""Helpers for files, processes, text and strict conversion that know nothing of cranes."""

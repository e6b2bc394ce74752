"""Reads and writes files of every kind, within limits; knows nothing of cranes."""

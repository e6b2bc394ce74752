"""Trains the reader of the display's digits."""

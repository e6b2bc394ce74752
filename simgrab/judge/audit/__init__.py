"""Proves the labels of a dataset."""

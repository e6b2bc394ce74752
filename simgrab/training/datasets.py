"""Datasets to learn from."""

from __future__ import annotations

from simgrab.datasets import Data, Dataset, digest, read, read_all

__all__ = ["Data", "Dataset", "digest", "read", "read_all"]

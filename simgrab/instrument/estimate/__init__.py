"""Tilt and swing from pixels: six estimators, one contract."""

from __future__ import annotations

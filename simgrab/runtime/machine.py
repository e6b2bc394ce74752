"""Cores and memory that this process may use, also within a container."""

from __future__ import annotations

import os
from pathlib import Path

import psutil

CGROUP = Path("/sys/fs/cgroup")
"""Where Linux states a container's limits (cgroup version 2)."""


def cores() -> int:
    """Cores that this process may use, at least 1."""
    process = psutil.Process()
    usable = len(process.cpu_affinity() or []) if hasattr(process, "cpu_affinity") else 0
    usable = usable or os.cpu_count() or 1
    quota, _, period = _limit("cpu.max").partition(" ")
    return max(1, min(usable, int(quota) // int(period))) if quota.isdigit() and period.isdigit() else usable


def free_bytes() -> int:
    """Memory that is free for this process."""
    free = int(psutil.virtual_memory().available)
    most, used = _limit("memory.max"), _limit("memory.current")
    return max(0, min(free, int(most) - int(used))) if most.isdigit() and used.isdigit() else free


def _limit(name: str) -> str:
    try:
        return (CGROUP / name).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""

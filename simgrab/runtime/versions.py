"""Versions on which numbers and pixels depend."""

from __future__ import annotations

import functools
import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("mujoco", "numpy", "opencv-python-headless", "pillow", "pyarrow", "pycocotools", "scipy", "trimesh")


def packages() -> dict[str, str]:
    """Versions of other packages."""
    return {name: version(name) for name in PACKAGES}


@functools.cache
def everything() -> dict[str, str]:
    """Versions of Python and other packages, and the digest of simgrab's source."""
    found = {"Python": ".".join(platform.python_version_tuple()[:2]), "simgrab's source": _source()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def _source() -> str:
    package, total = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        total.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return total.hexdigest()[:12]

"""Versions on which numbers and pixels depend."""

from __future__ import annotations

import functools
import hashlib
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("mujoco", "numpy", "opencv-python-headless", "pillow", "pyarrow", "pycocotools", "scipy", "trimesh")


@dataclass(frozen=True)
class Fingerprint:
    """The renderer of the pictures. Equal fingerprints render equal bytes; EGL and OSMesa of one Mesa build do too."""

    # renderer, version: name and version of OpenGL
    renderer: str
    version: str
    mujoco: str  # version
    passes: str = ""  # version of simgrab's own render passes; empty in datasets of before there were any

    def __str__(self) -> str:
        own = f", passes {self.passes}" if self.passes else ""
        return f"{self.renderer}, MuJoCo {self.mujoco}{own}"

    @property
    def digest(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of all fields that are not empty."""
        fields = filter(None, (self.renderer, self.version, self.mujoco, self.passes))
        return hashlib.sha256("\n".join(fields).encode()).hexdigest()[:16]


def packages() -> dict[str, str]:
    """Versions of other packages."""
    return {name: version(name) for name in PACKAGES}


@functools.cache
def everything() -> dict[str, str]:
    """Versions of Python and other packages, and the digest of simgrab's source."""
    return {"Python": ".".join(platform.python_version_tuple()[:2]), "simgrab's source": _source()} | packages()


def _source() -> str:
    package, total = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        total.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return total.hexdigest()[:12]

"""STEP files of CAD programs, converted to GLB by OpenCASCADE (`cascadio`, the extra ``step``).

The library is native code and files are untrusted, so it runs in its own process, with limits of time and memory.
"""

from __future__ import annotations

import importlib.util
import io
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from simgrab.io import models
from simgrab.io.parse import Refuse, read_bytes

MOST_SECONDS = 300.0
MOST_MEMORY = 8 * 2**30
"""Bytes."""
_ANGLE = 0.35  # rad between neighbouring facets of a curved surface
_CHILD = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[4]),) * 2)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import cascadio
sys.exit(cascadio.step_to_glb(
    sys.argv[1], sys.argv[2], tol_linear=float(sys.argv[3]), tol_angular=float(sys.argv[5]), use_parallel=False
))
"""


def glb(path: str | Path, refuse: Refuse, *, tolerance_mm: float = 2.0) -> bytes:
    """Convert a STEP file to a GLB file in metres, y up, with the names of the STEP file's parts.

    Facets are at most ``tolerance_mm`` from the exact surface. ``refuse`` makes the error to raise from a message, for
    a file that is not STEP, contains no surface or exceeds the limits of time or memory, and if `cascadio` is missing.
    """
    path = Path(path)
    if importlib.util.find_spec("cascadio") is None:
        raise refuse(f"{path.name}: STEP files need `pip install 'simgrab[step]'`")
    data = read_bytes(path, refuse, most_bytes=models.MOST_BYTES)
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise refuse(f"{path.name}: is not a STEP file")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "a.step", Path(folder) / "a.glb"
        source.write_bytes(data)
        command = [sys.executable, "-I", "-c", _CHILD, str(source), str(target), str(tolerance_mm), str(MOST_MEMORY)]
        try:
            done = subprocess.run([*command, str(_ANGLE)], capture_output=True, timeout=MOST_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            raise refuse(f"{path.name}: its conversion takes longer than {MOST_SECONDS:g} s") from None
        if done.returncode or not target.exists():
            raise refuse(f"{path.name}: is damaged, or too large for {MOST_MEMORY >> 30} GiB of memory")
        found = target.read_bytes()
    models.of_files("converted.glb", {"converted.glb": found}, lambda problem: refuse(f"{path.name}: {problem}"))
    scene = trimesh.load_scene(io.BytesIO(found), file_type="glb", process=False)
    if not scene.geometry:
        raise refuse(f"{path.name}: shows no surface")
    scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))  # OpenCASCADE leaves z up
    return bytes(scene.export(file_type="glb"))

"""The manifest: what a dataset is, from which the same one can be made again."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from simgrab._version import __version__
from simgrab.runtime import versions
from simgrab.world.extensions import Recipe
from simgrab.world.gl import Fingerprint


def identity(recipe: Recipe) -> dict[str, Any]:
    """Return what must be equal for two runs to make the same dataset, but for the renderer."""
    scenario, extensions = recipe.scenario, recipe.extensions.describe()
    return {
        "simgrab": __version__,
        "scenario": scenario.to_dict(),
        "digest": scenario.digest(),
        "seed": scenario.seed,
        "frames": scenario.frames,
        "packages": versions.packages(),
    } | ({"extensions": extensions} if extensions else {})


def compose(core: dict[str, Any], rendered_by: Fingerprint, digests: dict[str, str]) -> bytes:
    """Compose the manifest, as JSON.

    Parameters
    ----------
    core : dict
        See `identity`.
    rendered_by : Fingerprint
    digests : dict of str to str
        SHA-256 of the files, by name; a dataset's pictures have theirs in their row of labels.
    """
    manifest = core | {
        "renderer": {
            "renderer": rendered_by.renderer,
            "version": rendered_by.version,
            "mujoco": rendered_by.mujoco,
            "passes": rendered_by.passes,
            "fingerprint": rendered_by.digest,
        },
        "files": dict(sorted(digests.items())),
    }
    return json.dumps(manifest | {"manifest_digest": digest(manifest)}, indent=1).encode()


def digest(manifest: dict[str, Any]) -> str:
    """SHA-256 over the canonical JSON of a manifest, its own digest left out."""
    rest = {key: value for key, value in manifest.items() if key != "manifest_digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()

"""The manifest: it describes a dataset completely, so that the same dataset can be made again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

from simgrab._version import __version__
from simgrab.errors import DatasetError
from simgrab.model.scenario import Scenario
from simgrab.runtime import versions
from simgrab.runtime.versions import Fingerprint


def same_renderer(fingerprint: Fingerprint, first: Fingerprint | None, place: object) -> Fingerprint:
    """Refuse a renderer other than the one that began the dataset."""
    if first is not None and fingerprint != first:
        raise DatasetError(
            f"{place} was started with {first}, and this is {fingerprint}: "
            "choose another place, or delete what one of them rendered"
        )
    return fingerprint


def identity(scenario: Scenario, extensions: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the data that must be equal for two runs to make the same dataset; the renderer is compared apart.

    ``extensions`` are the manifest's entries for the user's own functions, if any.
    """
    return {
        "simgrab": __version__,
        "scenario": scenario.to_dict(),
        "digest": scenario.digest(),
        "seed": scenario.seed,
        "frames": scenario.frames,
        "packages": versions.packages(),
    } | ({"extensions": extensions} if extensions else {})


def compose(core: dict[str, Any], rendered_by: Fingerprint, digests: dict[str, str]) -> bytes:
    """Compose the manifest, as JSON, of an `identity` and more.

    ``digests`` are the SHA-256 of the files, by name; those of the pictures are in the labels.
    """
    manifest = core | {
        "renderer": asdict(rendered_by) | {"fingerprint": rendered_by.digest},
        "files": dict(sorted(digests.items())),
    }
    return json.dumps(manifest | {"manifest_digest": digest(manifest)}, indent=1).encode()


def digest(manifest: dict[str, Any]) -> str:
    """SHA-256 of the canonical JSON of a manifest without its own digest."""
    rest = {key: value for key, value in manifest.items() if key != "manifest_digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()

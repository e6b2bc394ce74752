"""Rendered datasets, kept between checks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

from simgrab.errors import DatasetError, RendererError
from simgrab.judge.doctor import examine
from simgrab.labels import datasets
from simgrab.labels.datasets import MANIFEST, Dataset
from simgrab.scenario import Scenario
from simgrab.utilities.files import discard, locked, remove_left
from simgrab.utilities.resources import ASSETS
from simgrab.world.extensions import Recipe
from simgrab.world.output import manifest
from simgrab.world.output.dataset import render
from simgrab.world.output.folder import writing

PACKAGE = Path(__file__).parents[2]
# Rooms and assets that change no pixel and no label.
ELSEWHERE = ("pages", "instrument", "judge", "training", "browse", "studio", "cli")

Progress = Callable[[int, int], None]


def default() -> Path:
    """User's cache folder, after the XDG base directory specification."""
    return user_cache_path("simgrab")


def rendered(
    scenario: Scenario, where: Path, *, workers: int = 1, cluster: str | None = None, progress: Progress | None = None
) -> Dataset:
    """Find a scenario's dataset in the cache, or render it there.

    A dataset counts as the same while scenario, renderer, packages and the rendering code are the same. One whose
    pictures are not those of its labels any more is rendered again.

    Parameters
    ----------
    scenario : Scenario
    where : Path
        The cache.
    workers : int
        Worker processes.
    cluster : str, optional
        Address of a Ray cluster that renders in their place.
    progress : callable, optional
        Called with (frames done, frames in all).

    Raises
    ------
    ScenarioError, DatasetError, RendererError
        As `simgrab.world.output.dataset.render`.
    """
    folder = where / f"{scenario.name}-{_key(scenario)}"
    with ExitStack() as stack:
        with writing(where):
            where.mkdir(parents=True, exist_ok=True)
            # another check may be rendering the same
            stack.enter_context(locked(where / f".{folder.name}.lock", wait=True))
        remove_left(folder)
        if (folder / MANIFEST).exists() and not _sound(folder):
            discard(folder)
        render(scenario, folder, workers=workers, cluster=cluster, resume=True, progress=progress)
        return datasets.read(folder)


def _sound(folder: Path) -> bool:
    """Whether a finished dataset holds the pictures that it was finished with."""
    try:
        found = datasets.read(folder)
    except DatasetError:
        return False
    digests = ((row.image_sha256, hashlib.sha256(found.image(row).read_bytes()).hexdigest()) for row in found.rows)
    return all(written == read for written, read in digests)


def _key(scenario: Scenario) -> str:
    whole = [manifest.identity(Recipe(scenario)), _renderer(), _drawing_code()]
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:20]


@cache
def _renderer() -> str:
    found = examine()
    if found.renderer is None:
        raise RendererError(found.problem)
    return found.renderer.digest


@cache
def _drawing_code() -> str:
    """Digest of the modules and assets that pictures and labels depend on."""
    modules = [p for p in PACKAGE.rglob("*.py") if p.relative_to(PACKAGE).parts[0] not in ELSEWHERE]
    assets = [p for p in ASSETS.rglob("*") if p.is_file() and p.relative_to(ASSETS).parts[0] != "weights"]
    total = hashlib.sha256()
    for path in sorted(modules) + sorted(assets):
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()

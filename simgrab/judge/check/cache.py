"""Rendered datasets, kept between checks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

from simgrab.dataset import datasets, manifest
from simgrab.dataset.datasets import MANIFEST, Dataset
from simgrab.dataset.pool import Workers, automatic, vetted
from simgrab.dataset.render import render
from simgrab.errors import DatasetError
from simgrab.io.destination import writing
from simgrab.io.files import discard, locked, remove_left, sha256
from simgrab.io.resources import ASSETS
from simgrab.judge.doctor import fingerprint
from simgrab.model.scenario import Scenario
from simgrab.world.extensions import Recipe

PACKAGE = Path(__file__).parents[2]
# Where the code is that decides pixels and labels.
_ROOMS = ("runtime", "io", "model", "world", "dataset", "lab/sensors", "training/assembled")
DRAWING = ("errors.py", "text.py", *(f"{room}/**/*.py" for room in _ROOMS))

Progress = Callable[[int, int], None]


def default() -> Path:
    """User's cache folder, after the XDG base directory specification."""
    return user_cache_path("simgrab")


def rendered(
    scenario: Scenario, where: Path, *, workers: int = 1, cluster: str | None = None, progress: Progress | None = None
) -> Dataset:
    """Find a scenario's dataset in the cache, or render it there.

    A dataset is reused if scenario, renderer, packages and the rendering code are the same. It is rendered again if its
    pictures no longer match its labels. Options and errors are those of `simgrab.dataset.render.render`, but there are
    no more workers than `simgrab.dataset.pool.automatic` chooses.
    """
    folder = _folder(scenario, where)
    with ExitStack() as stack:
        with writing(where, DatasetError):
            where.mkdir(parents=True, exist_ok=True)
            # another check may be rendering the same
            stack.enter_context(locked(where / f".{folder.name}.lock", wait=True))
        remove_left(folder)
        if (folder / MANIFEST).exists() and not _sound(folder):
            discard(folder)
        workers = min(workers, automatic(Recipe(scenario))[0])
        render(scenario, folder, workers=workers, cluster=cluster, resume=True, progress=progress)
        return datasets.read(folder)


def check_possible(scenario: Scenario, where: Path) -> None:
    """Refuse a scenario with an impossible frame (`ScenarioError`) if it was not rendered before and does not vary."""
    recipe = Recipe(scenario)
    if not (recipe.varies or (_folder(scenario, where) / MANIFEST).exists()):
        vetted(Workers(recipe))


def _folder(scenario: Scenario, where: Path) -> Path:
    return where / f"{scenario.name}-{_key(scenario)}"


def _sound(folder: Path) -> bool:
    """Whether a finished dataset still has its original pictures."""
    try:
        found = datasets.read(folder)
    except DatasetError:
        return False
    return all(row.image_sha256 == sha256(found.image(row)) for row in found.rows)


def _key(scenario: Scenario) -> str:
    whole = [manifest.identity(scenario), fingerprint().digest, _drawing_code()]
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:20]


def drawing_modules() -> list[Path]:
    """Modules on which pictures and labels depend."""
    return sorted(path for place in DRAWING for path in PACKAGE.glob(place))


@cache
def _drawing_code() -> str:
    """Digest of the modules and assets on which pictures and labels depend."""
    assets = [p for p in ASSETS.rglob("*") if p.is_file() and p.relative_to(ASSETS).parts[0] != "weights"]
    total = hashlib.sha256()
    for path in drawing_modules() + sorted(assets):
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()

"""Find, read and change scenarios: bundled scenes by name, TOML files, a finished dataset's manifest."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from simgrab.errors import ScenarioError
from simgrab.io import models, photographs, resources
from simgrab.io.models import ModelFile, copied
from simgrab.io.parse import MOST_LEVELS, Refuse, find_misfit, parse_value, read_json, read_toml, shown
from simgrab.io.resources import SCENES
from simgrab.io.strict import convert, without_numpy
from simgrab.model.scenario import FontFile, Mesh, Photo, Scenario, merged, vary
from simgrab.model.scenario import resized as resized
from simgrab.model.scenario.factor import JOINT

_REFUSE = functools.partial(ScenarioError, "")


def names() -> list[str]:
    """Names of the bundled scenes."""
    return resources.names(SCENES)


def load(
    scene: str | Path = "quay-day",
    changes: Mapping[str, Any] | None = None,
    *,
    size: tuple[int, int] | None = None,
    within: Path | None = None,
) -> Scenario:
    """Read a scenario and apply changes to it.

    Parameters
    ----------
    scene : str or Path
        A bundled scene's name (see `names`), a TOML file, or the ``manifest.json`` of a dataset.
    changes : mapping, optional
        Dotted keys to values, e.g. ``{"camera.beta_deg": 5.0}``. As in a scene file over its base, a key that is set
        does not vary any more.
    size : tuple of 2 ints, optional
        Width and height of the images, px, which then show the same view; see `resized`. The keys ``camera.width_px``
        and ``camera.height_px`` crop instead, because the focal length in pixels stays.
    within : Path, optional
        Folder that must contain the models, photographs and fonts named in an untrusted scene file. By default they may
        be anywhere, and those in ``changes`` always may.

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        With one line that names the key and the valid values.

    Examples
    --------
    >>> load("quay-day", {"camera.beta_deg": 5.0}).camera.beta_deg
    5.0
    """
    if not isinstance(changes, Mapping | None):
        raise ScenarioError("", f"changes must be a mapping from dotted keys to values, got {type(changes).__name__}")
    change: dict[str, Any] = {}
    for key, value in (changes or {}).items():
        change = merged(change, vary.nested(key, without_numpy(value)))
    if misfit := find_misfit(change):
        raise ScenarioError(*misfit)
    factors = change.get("vary")
    varied = {part for name in factors for part in name.split(JOINT)} if isinstance(factors, Mapping) else set()
    for key in sorted(varied & set(changes or ())):
        raise ScenarioError(key, "the same call sets and varies this key; leave out one of the two")
    change = _with_models(change, lambda table, refuse: _kind(table).read(table["file"], refuse))
    scenario = convert(vary.laid_over(_read(scene, within), change, changes or ()), Scenario)
    vary.check(scenario)
    return scenario if size is None else resized(scenario, *size)


def manifest(scene: str | Path) -> dict[str, Any] | None:
    """Plain data of a manifest that names a scenario; None of a bundled scene or a TOML file."""
    path = resources.find(scene, SCENES, "scene", "scenes", _REFUSE)
    if path.suffix != ".json":
        return None
    data = read_json(path, _REFUSE)
    return data if isinstance(data, dict) else None


def parse_changes(assignments: Iterable[str]) -> dict[str, Any]:
    """Parse ``a.b=value`` assignments; values are TOML, and dates and anything else are taken as strings."""
    changes: dict[str, Any] = {}
    tables: dict[str, dict[str, Any]] = {}
    for assignment in assignments:
        key, equals, text = (s.strip() for s in assignment.partition("="))
        if not equals or not key or not text:
            raise ScenarioError("", f"--set takes key=value, got {shown(assignment)}")
        factor = re.fullmatch(r"(vary|every)\.([\"'])(.+)\2", key)  # whose own key has dots in it
        within, name = (tables.setdefault(factor[1], {}), factor[3]) if factor else (changes, key)
        if name in within:
            raise ScenarioError(key, f"--set gives it twice: {shown(within[name])} and {shown(text)}")
        within[name] = parse_value(text, functools.partial(ScenarioError, key), "--set")
    if twice := min(tables.keys() & changes, default=""):
        raise ScenarioError(twice, f"--set gives it twice: {shown(changes[twice])} and {shown(tables[twice])}")
    return changes | tables


def parse_size(text: str) -> tuple[int, int]:
    """Parse ``640x360`` into width and height, px."""
    size = re.fullmatch(r"\s*(\d{1,9})\s*[x×]\s*(\d{1,9})\s*", text, re.IGNORECASE)
    if not size:
        raise ScenarioError("", f"size must be WIDTHxHEIGHT in pixels, such as 640x360; got {text!r}")
    return int(size[1]), int(size[2])


def _read(scene: str | Path, within: Path | None = None) -> dict[str, Any]:
    """Plain data of a whole scene: laid over its base where it names one, and over the defaults."""
    path = resources.find(scene, SCENES, "scene", "scenes", _REFUSE)
    data, _ = _of_file(path, within)
    base = data.pop("base", None) if path.suffix != ".json" else None
    if base is None:
        return merged(_defaults(), data)
    if base not in names():
        raise ScenarioError("base", f"{path}: no bundled scene {base!r}; one of: {', '.join(names())}")
    vary.check_stated(data)
    return vary.laid_over(_read(base), data)


def _defaults() -> dict[str, Any]:
    return dict(msgspec.to_builtins(Scenario()))


def _of_file(path: Path, within: Path | None) -> tuple[dict[str, Any], dict[tuple[str, str], Path]]:
    """Plain data of a scene file or a manifest, and the paths of the models that it names; see `model_files`."""
    is_manifest, paths = path.suffix == ".json", dict[tuple[str, str], Path]()

    def read(table: Mapping[str, Any], refuse: Refuse) -> ModelFile:
        file = _copy(path.parent, table, refuse) if is_manifest else _named(path, table, refuse, within)
        model: ModelFile = _kind(table).read(file, refuse)
        paths[model.sha256, model.name] = file
        return model

    data = _scenario_of(read_json(path, _REFUSE), path) if is_manifest else read_toml(path, _REFUSE)
    return _with_models(data, read), paths


def _copy(dataset: Path, table: Mapping[str, Any], refuse: Refuse) -> Path:
    """Find the copy in a dataset of the file that a table of its manifest names."""
    return models.inside(dataset, f"{copied(str(table.get('sha256')))}/{table['file']}", refuse)


def _named(scene: Path, table: Mapping[str, Any], refuse: Refuse, within: Path | None) -> Path:
    """Find the file that a table of a scene file names: from the scene's folder, or absolute."""
    file = scene.parent / str(table["file"])
    if within is not None:
        try:
            leaves = not file.resolve().is_relative_to(within.resolve())
        except (OSError, ValueError, RuntimeError):  # a NUL byte, a loop of links
            leaves = True
        if leaves:
            raise refuse(f"names {shown(table['file'])}, which is outside of {within}")
    return file


_READERS: dict[str, ModuleType] = {str(kind.__struct_config__.tag): kind.reader for kind in (Mesh, Photo, FontFile)}
"""Modules that read the file of a table, by its ``model``."""


def _kind(table: Mapping[str, Any]) -> ModuleType:
    """Give the module that reads the file of a table."""
    return _READERS.get(str(table.get("model")), models)


def _with_models(data: Any, read: Callable[[Mapping[str, Any], Refuse], ModelFile], key: str = "") -> Any:
    """Name models, photographs and fonts by file name and SHA-256, wherever a scene's plain data have a path."""
    if key.count(".") > MOST_LEVELS:
        return data  # refused later
    if isinstance(data, Mapping):
        inner = {name: _with_models(value, read, f"{key}.{name}".lstrip(".")) for name, value in data.items()}
        file = data.get("file")
        if not isinstance(file, str) or not (str(data.get("model")) in _READERS or key == "grab"):
            return inner
        refuse = functools.partial(ScenarioError, f"{key}.file")
        model = read(data, refuse)
        stated = data.get("sha256")
        if stated and stated != model.sha256:
            raise ScenarioError(f"{key}.sha256", f"{file} has different content, with SHA-256 {model.sha256}")
        return inner | {"file": model.name, "sha256": model.sha256}
    if isinstance(data, list | tuple):
        return [_with_models(value, read, f"{key}.{i}") for i, value in enumerate(data)]
    return data


def of_manifest(manifest: Any, where: str | Path, read: Callable[[str, int], bytes]) -> Scenario:
    """Build the scenario that a manifest holds.

    Parameters
    ----------
    manifest : object
        Plain data.
    where : str or Path
        Begins the error line.
    read : callable
        Gives a file of the dataset, by its name, of at most so many bytes.

    Raises
    ------
    ScenarioError
    """
    data = _scenario_of(manifest, where)
    listed = manifest.get("files")

    def copy(table: Mapping[str, Any], refuse: Refuse) -> ModelFile:
        folder = f"{copied(str(table.get('sha256')))}/"
        names = [name.removeprefix(folder) for name in listed or () if name.startswith(folder)]
        left, files = models.MOST_BYTES, dict[str, bytes]()
        for name in names[: photographs.MOST_FILES]:  # of models there may be fewer
            files[name] = read(f"{folder}{name}", left)
            left -= len(files[name])
        return _kind(table).of_files(table["file"], files, refuse)

    return of_data(data, copy)


def of_data(data: Mapping[str, Any], read: Callable[[Mapping[str, Any], Refuse], ModelFile]) -> Scenario:
    """Build a scenario from a scene's plain data, as in a file; missing keys have their defaults.

    ``read`` gives the model of a table that names one, and refuses what may not be read.

    Raises
    ------
    ScenarioError
    """
    scenario = convert(merged(_defaults(), _with_models(data, read)), Scenario)
    vary.check(scenario)
    return scenario


def model_files(scene: str | Path, within: Path | None = None) -> dict[tuple[str, str], Path]:
    """Find the paths of the models that a scene names, by SHA-256 and file name; parameters as for `load`.

    Raises
    ------
    ScenarioError
        If the scene or a model cannot be read.
    """
    _, paths = _of_file(resources.find(scene, SCENES, "scene", "scenes", _REFUSE), within)
    return paths


def _scenario_of(manifest: Any, where: str | Path) -> dict[str, Any]:
    scenario = manifest.get("scenario") if isinstance(manifest, dict) else None
    if not isinstance(scenario, dict):
        raise _REFUSE(f"{where} is not a simgrab manifest: it holds no scenario")
    return scenario

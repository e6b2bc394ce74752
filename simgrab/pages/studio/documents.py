"""Scenes that the page edits: where they come from, what they may name, and where they are saved.

A page is not trusted. The scene that it sends is plain data. It may name models of grabs that the scenes opened here
named themselves, and files in the folder of the scene given at the start or below it. It opens and saves scene files
in the folder that the command was started in, or below it, and nothing else; those that it opens name files there too.
The scene given at the start is the user's word, and may name any file.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import tomli_w

from simgrab.errors import ScenarioError, SimgrabError
from simgrab.io import files, models, resources
from simgrab.io.destination import check_file, writing
from simgrab.io.models import ModelFile
from simgrab.io.parse import Refuse, is_file, read_toml
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.whole import difference

MOST_LISTED = 200
"""Scene files of a folder."""
_REFUSE = functools.partial(ScenarioError, "")


class ExistsError(SimgrabError):
    """A file that would be replaced."""


class Documents:
    """The scenes that a page may open, name and save.

    Parameters
    ----------
    scene : str or Path
        Given at the start: a bundled scene's name, a scene file, or a dataset's ``manifest.json``.
    root : Path
        Folder below which scenes are opened and saved.

    Raises
    ------
    ScenarioError
        If it cannot be read.
    """

    def __init__(self, scene: str | Path, root: Path) -> None:
        self.origin, self.root = str(scene), root.absolute()
        self._models: dict[tuple[str, str], Path] = {}
        self.start = self._read(scene)
        path = resources.find(scene, resources.SCENES, "scene", "scenes", _REFUSE)
        bundled = path.parent == resources.SCENES
        self.folder = None if bundled else path.parent.absolute()
        """Of the scene file given at the start; None where that is bundled."""

    def _read(self, scene: str | Path, within: Path | None = None) -> Scenario:
        scenario = scenes.load(scene, within=within)
        if scenario.models:
            self._models |= scenes.model_files(scene, within)
        return scenario

    def names(self) -> list[str]:
        """Name the scenes that `open` takes: those that are bundled, and scene files in the folder."""
        own = sorted(path.name for path in self.root.glob("[!.]*.toml") if self._holds_scene(path))
        return [*scenes.names(), *own[:MOST_LISTED]]

    def _holds_scene(self, path: Path) -> bool:
        """Whether a TOML file looks like a scene, by its tables: settings of other tools lie about too."""
        try:
            data = read_toml(path, _REFUSE)
        except SimgrabError:
            return False
        return bool(data) and set(data) <= {"base", *Scenario.__struct_fields__}

    def open(self, name: str) -> Scenario:
        """Read a scene: the one given at the start, a bundled one, or a file below the folder.

        Raises `ScenarioError`.
        """
        if name == self.origin or name in scenes.names():
            return self._read(name)
        return self._read(self._below(name), within=self.root)

    def parse(self, data: Any) -> Scenario:
        """Build the scenario that a page describes; raises `ScenarioError` with the dotted key that does not fit."""
        if not isinstance(data, Mapping):
            raise ScenarioError("", "a scene is a table of keys and values")
        return scenes.of_data(data, self._model)

    def _model(self, table: Mapping[str, Any], refuse: Refuse) -> ModelFile:
        """Read the model that a table names, if it may name it."""
        name, sha256 = str(table["file"]), str(table.get("sha256"))
        if (sha256, name) in self._models:
            return models.recall(sha256, name, refuse)
        if self.folder is None:
            raise refuse("start simgrab studio with a scene file of your own: models lie in its folder or below")
        file = models.inside(self.folder, name, refuse)
        model = models.read(file, refuse)
        self._models[model.sha256, model.name] = file
        return model

    def toml(self, scenario: Scenario, folder: Path | None = None) -> str:
        """Write a scene file, without what has its default, to lie in a folder: unless given, the first scene's.

        Raises `ScenarioError` if a file that it names is not known here.
        """
        written = difference(Scenario().to_dict(), scenario.to_dict())
        if scenario.models:
            written = self._placed(written, (folder or self.folder or self.root).resolve())
        return tomli_w.dumps(written)

    def _placed(self, value: Any, folder: Path) -> Any:
        """Name models by their paths from a folder."""
        if isinstance(value, list):
            return [self._placed(inner, folder) for inner in value]
        if not isinstance(value, dict):
            return value
        placed = {key: self._placed(inner, folder) for key, inner in value.items()}
        file = self._models.get((str(value.get("sha256")), str(value.get("file"))))
        if file is not None:
            placed["file"] = os.path.relpath(file.parent.resolve() / file.name, folder)
        return placed

    def save(self, scenario: Scenario, name: str, *, replace: bool = False) -> Path:
        """Save a scene file below the folder.

        Parameters
        ----------
        name : str
            Path within the folder; its own folder must be there.
        replace : bool
            Whether a scene file that is there is replaced. Any other file never is.

        Raises
        ------
        ScenarioError
            If it may not, or cannot, be written.
        ExistsError
            If a scene file is there.
        """
        path = self._below(name)
        if path.is_symlink():
            raise ScenarioError("", f"{name} is a link; choose another name")
        check_file(path, _REFUSE, "name")
        if not path.parent.is_dir():
            raise ScenarioError("", f"there is no folder {path.parent}")
        if is_file(path, _REFUSE):
            if not self._holds_scene(path):
                raise ScenarioError("", f"{name} is not a scene file, and is not replaced; choose another name")
            if not replace:
                raise ExistsError(f"{name} exists")
        text = self.toml(scenario, path.parent)
        with writing(path, _REFUSE):
            files.write(path, text)
        return path

    def _below(self, name: str) -> Path:
        """Find the path of a scene file below the folder."""
        path = PurePosixPath(name)
        if path.suffix != ".toml" or any(part.startswith(".") for part in path.parts):
            raise ScenarioError("", "name a scene file that ends in .toml, below the folder; no part begins with a dot")
        return models.inside(self.root, name, lambda _: ScenarioError("", f"the file must lie below {self.root}"))

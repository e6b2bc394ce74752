"""Types of options, shared by verbs."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from simgrab.errors import DatasetError, RunError, SimgrabError
from simgrab.io.destination import check_file, check_folder, check_new_folder
from simgrab.io.stores import is_url


class _Place(click.Path):
    """A path or, with ``urls``, the URL of a store. An empty path is refused: it would mean the working folder."""

    def __init__(self, *, urls: bool = False) -> None:
        super().__init__(path_type=Path)
        self._urls = urls
        self.name = "path or URL" if urls else self.name

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse what is empty."""
        if value == "":
            self.fail("a path must not be empty", param, ctx)
        if self._urls and isinstance(value, str) and value.lower().startswith("memory:"):
            self.fail("memory:// ends with the command; give a folder or another URL", param, ctx)
        return value if self._urls and is_url(value) else super().convert(value, param, ctx)


class _Destination(_Place):
    """A path to write to. It is checked first, because importing the command's modules takes seconds; a URL is not."""

    def __init__(self, check: Callable[..., None], error: type[SimgrabError] = RunError, *, urls: bool = False) -> None:
        super().__init__(urls=urls)
        self._check, self._error = check, error

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse a path that cannot be written."""
        place = super().convert(value, param, ctx)
        if isinstance(place, Path):
            self._check(place, self._error, param.opts[0] if param else "path")
        return place


PATH, PATH_OR_URL = _Place(), _Place(urls=True)
FOLDER_OR_URL = _Destination(check_folder, urls=True)
FOLDER, NEW_FOLDER = _Destination(check_folder), _Destination(check_new_folder)
FILE = _Destination(check_file, DatasetError)
WORKERS = click.IntRange(1, 256)


class _Automatic(click.ParamType):  # type: ignore[type-arg]  # generic from click 8.3 on
    """A number of processes, or ``auto``, which is None."""

    name = "integer or auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | None:
        return None if value in (None, "auto") else WORKERS.convert(value, param, ctx)


AUTO_WORKERS = _Automatic()


class FiniteRange(click.FloatRange):
    """A number in a range, in which click finds NaN as well."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Refuse NaN."""
        number = float(super().convert(value, param, ctx))
        return self.fail(f"{number} is not a number", param, ctx) if math.isnan(number) else number


class EstimatorName(click.Choice):  # type: ignore[type-arg]  # generic from click 8.2 on
    """Names of estimators, which may be shortened."""

    def __init__(self) -> None:
        from simgrab.instrument.estimate import ESTIMATORS

        super().__init__(list(ESTIMATORS))
        self._full = ESTIMATORS.full

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Complete the name."""
        return super().convert(self._full(value), param, ctx)


F = TypeVar("F", bound=Callable[..., Any])


def together(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Make one decorator of several options, which the help lists in this order."""

    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


detector_option = click.option(
    "--detector",
    "detector_name",
    default="bundled",
    show_default=True,
    help="Or a folder of `train detector`, or a YOLO's .onnx.",
)
imu_option = click.option(
    "--imu", type=PATH, help="Folder of the inertial sensor in the camera's housing, e.g. sensors/clip_000/imu0."
)
plc_option = click.option(
    "--plc", type=PATH, help="Data of the crane's controller, CSV or parquet, with a TOML of the same name beside."
)
cluster_option = click.option("--cluster", help="Ray cluster to work on: auto, ray://HOST:10001 or HOST:6379.")

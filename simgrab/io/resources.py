"""Places of the bundled files: inside the installed wheel, or beside the package in a checkout."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterable
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def _folder(name: str) -> Path:
    installed = _PACKAGE / f"_{name}"
    return installed if installed.is_dir() else _PACKAGE.parent / name


ASSETS = _folder("assets")
SCENES = _folder("scenes")


def names(folder: Path) -> list[str]:
    """Names of the bundled TOML files in a folder."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def find(wanted: str | Path, folder: Path, kind: str, kinds: str, refuse: Callable[[str], Exception]) -> Path:
    """Find a bundled TOML file by its name in a folder, or any file by its path.

    ``kind`` and ``kinds`` are the singular and plural name of this kind of file in messages; ``refuse`` makes the error
    to raise from a line that lists the valid names.
    """
    if not isinstance(wanted, str | os.PathLike):
        raise refuse(f"a {kind} is a name or a path, got {type(wanted).__name__}")
    path = Path(wanted)
    try:
        if wanted in names(folder):
            return folder / f"{wanted}.toml"
        if wanted and not path.is_dir() and (path.exists() or path.is_symlink()):
            return path
        folder_there = bool(str(wanted)) and path.is_dir()
        what = f"{str(wanted)!r} is a folder, not a {kind}" if folder_there else f"no {kind} or file {str(wanted)!r}"
        file = path.with_name(f"{path.name}.toml") if path.name else path
        without_suffix = not folder_there and file.is_file()
    except OSError as problem:  # a name that is too long, a folder that may not be searched
        raise refuse(f"cannot read {path}: {problem.strerror}") from None
    there = names(folder)
    hint = f" (did you mean {str(file)!r}?)" if without_suffix else suggestion(str(wanted), there)
    raise refuse(f"{what}{hint}; bundled {kinds}: {', '.join(there)}")


def suggestion(word: str, valid: Iterable[str]) -> str:
    """Return a question whether the nearest valid word was meant; empty if none is near."""
    close = difflib.get_close_matches(word, list(valid), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""

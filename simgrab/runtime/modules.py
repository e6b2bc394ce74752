"""Import an object that a user names as ``package.module:attribute``."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
from pathlib import Path
from typing import Any


def find(module: str, attribute: str) -> Any:
    """Import a module and return one of its attributes; raises whatever importing it raises, and AttributeError.

    If there is no such module, the message of the ModuleNotFoundError says which folders were searched.
    """
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as problem:
        if not f"{module}.".startswith(f"{problem.name}."):  # one that the module imports
            raise
        searched = dict.fromkeys(str(Path(folder).absolute()) for folder in sys.path)
        own = [folder for folder in searched if not folder.startswith((sys.prefix, sys.base_prefix))]
        where = ", ".join([*own, f"the packages of {sys.prefix}"])
        raise ModuleNotFoundError(f"{problem}; searched: {where}", name=problem.name) from None


def source_sha256(defined: Any) -> str | None:
    """SHA-256 of the file that defines a function or class, or else of its own source; None if neither is known."""
    try:
        file = inspect.getsourcefile(defined)
        source = Path(file).read_bytes() if file and Path(file).is_file() else inspect.getsource(defined).encode()
    except (OSError, TypeError):
        return None
    return hashlib.sha256(source).hexdigest()

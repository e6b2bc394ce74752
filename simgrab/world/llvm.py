"""Separate triton's LLVM from the LLVM of Mesa's software renderer."""

from __future__ import annotations

import ctypes
import importlib.abc
import importlib.util
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType


class _Finder(importlib.abc.MetaPathFinder):
    """Loads triton's library when triton is about to be imported, as torch's optimisers do."""

    _asked = False

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None  # noqa: ARG002
    ) -> ModuleSpec | None:  # fmt: skip
        if fullname != "triton" or self._asked:
            return None
        self._asked = True  # in a list that is gone through just now, from which it cannot be taken out
        spec = importlib.util.find_spec(fullname)
        for folder in (spec and spec.submodule_search_locations) or ():
            for library in Path(folder).glob("_C/libtriton*.so"):
                with suppress(OSError):
                    ctypes.CDLL(str(library), mode=os.RTLD_NOW | os.RTLD_DEEPBIND)
        return spec


def keep_apart() -> None:
    """Let triton find its own LLVM, whenever it is imported after Mesa was loaded.

    The loader searches Mesa's symbols before those of libraries that come later. Triton would call functions of another
    LLVM version, and the process would crash with a segmentation fault.
    """
    if "triton" not in sys.modules and not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())

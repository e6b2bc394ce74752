"""One fuzzed input: the files that a user would hand to simgrab."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ABOUT, INPUT, REPORT = "case.json", "input", "report.txt"


@dataclass(frozen=True)
class Files:
    """What a generator makes.

    Attributes
    ----------
    content : dict of str to bytes
        By path, relative to the folder that they are written to. Names that are no UTF-8 hold surrogates, as Python
        decodes them.
    target : str
        The file or folder among them that simgrab opens.
    """

    content: Mapping[str, bytes]
    target: str

    def write(self, folder: Path) -> None:
        """Write all files below a folder."""
        for name, data in self.content.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)


@dataclass(frozen=True)
class Case:
    """An input and where it comes from.

    Attributes
    ----------
    kind : str
    number : int
        Among the inputs of its kind.
    generator : str
        ``"structure"`` or ``"bytes"``.
    files : Files
    """

    kind: str
    number: int
    generator: str
    files: Files


def keep(case: Case, folder: Path, report: str) -> Path:
    """Write a case with what went wrong; returns the file that `load` takes."""
    shutil.rmtree(folder, ignore_errors=True)
    case.files.write(folder / INPUT)
    (folder / REPORT).write_text(report, encoding="utf-8", errors="backslashreplace")
    about = {"kind": case.kind, "number": case.number, "generator": case.generator, "target": case.files.target}
    (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n", encoding="ascii")
    return folder / ABOUT


def load(path: Path) -> Case:
    """Read a case that `keep` wrote."""
    about = json.loads(path.read_text(encoding="ascii"))
    root = path.parent / INPUT
    content = {
        os.path.relpath(Path(folder) / name, root): (Path(folder) / name).read_bytes()
        for folder, _, names in os.walk(root)
        for name in names
    }
    return Case(about["kind"], about["number"], about["generator"], Files(content, about["target"]))

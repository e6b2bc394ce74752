"""Delete rooms of the package from a copy of the checkout, and run the remaining tests there.

    scripts/python -m scripts.without_room lab pages -- -n 2 tests

What stands after ``--`` is given to pytest; by default all tests run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("lab", "match", "pages", "training")


def copy_without(rooms: Collection[str], folder: Path) -> None:
    """Copy the checkout into a folder, without rooms of the package and their tests; what is not code is linked."""
    for name in ("simgrab", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc.*"))  # of other processes
        for room in rooms:
            shutil.rmtree(folder / name / room, ignore_errors=True)
    for path in ROOT.iterdir():
        if not path.name.startswith(".") and not (folder / path.name).exists():
            (folder / path.name).symlink_to(path)


def run(folder: Path, *arguments: str) -> int:
    """Run Python in such a folder; gives its exit status."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, check=False).returncode


def main(arguments: Sequence[str]) -> int:
    """Run the tests without the named rooms; gives pytest's exit status."""
    at = arguments.index("--") if "--" in arguments else len(arguments)
    rooms = arguments[:at]
    if not rooms or not set(rooms) <= set(ROOMS):
        sys.exit(f"name rooms, of {', '.join(ROOMS)}")
    with tempfile.TemporaryDirectory() as folder:
        copy_without(rooms, Path(folder))
        return run(Path(folder), "-m", "pytest", *arguments[at + 1 :])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

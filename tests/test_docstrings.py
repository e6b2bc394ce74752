"""Examples in docstrings run and give what they show, but for the few marked as skipped, which take minutes."""

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in (ROOT / "simgrab").rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.fixture
def folder(dataset, tmp_path, monkeypatch):
    """A working directory with a finished dataset, which examples open as ``runs/quay-day``."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "quay-day").symlink_to(dataset)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.usefixtures("folder")
def test_examples_give_what_they_show(name):
    if name.startswith("simgrab.training"):
        pytest.importorskip("torch")
    every = doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(name))
    found = [test for test in every if test.examples]
    assert found
    for test in found:
        shown = []
        outcome = doctest.DocTestRunner().run(test, out=shown.append)
        assert outcome.failed == 0, "".join(shown)

"""The blocks of docs/loading.md and docs/frames.md run, each where its package is installed."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

PAGES = [
    (Path(__file__).parents[2] / "docs" / name).read_text(encoding="utf-8") for name in ("loading.md", "frames.md")
]
BLOCKS = {t: b for p in PAGES for t, b in re.findall(r"^## (.+?)\n.*?```python\n(.*?)```", p, re.DOTALL | re.MULTILINE)}


def packages(code):
    """Packages that a block imports."""
    for node in ast.parse(code).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.split(".")[0]


@pytest.fixture
def place(split_dataset, tmp_path):
    """A folder in which the dataset that the page speaks of lies."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "quay-day").symlink_to(split_dataset)
    return tmp_path


def test_every_block_of_the_pages_is_run():
    assert [(page.count("```python"), page.count("\n## ")) for page in PAGES] == [(7, 7), (5, 5)]
    assert len(BLOCKS) == 12


@pytest.mark.parametrize("title", BLOCKS)
def test_the_block_runs(title, place, monkeypatch, capsys):
    missing = [name for name in packages(BLOCKS[title]) if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} is not installed")
    if not {"datasets", "DataLoader"} & set(re.findall(r"\w+", BLOCKS[title])):
        monkeypatch.chdir(place)
        with warnings.catch_warnings(action="ignore"):
            exec(BLOCKS[title], {"__name__": "__main__"})
        assert capsys.readouterr().out
        return
    # These start processes, or read their environment when they are imported.
    offline = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(place / "cache")}
    (place / "block.py").write_text(BLOCKS[title], encoding="utf-8")
    offline |= {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "block.py"], cwd=place, env=offline, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout

"""The blocks of docs/loading.md run, each where its package is installed."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "loading.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^## (.+?)\n.*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE))


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


def test_every_block_of_the_page_is_run():
    assert len(BLOCKS) == PAGE.count("```python") == PAGE.count("\n## ") == 7


@pytest.mark.parametrize("title", BLOCKS)
def test_the_block_runs(title, place):
    missing = [name for name in packages(BLOCKS[title]) if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} is not installed")
    offline = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(place / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", BLOCKS[title]], cwd=place, env=offline, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout

"""The blocks of docs/loading.md and docs/frames.md run, each where its package is installed."""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from simgrab.cli import cli as simgrab

PAGES = [
    (Path(__file__).parents[2] / "docs" / name).read_text(encoding="utf-8") for name in ("loading.md", "frames.md")
]
PAGES[0], TRAINERS = PAGES[0].split("\n## Trainers\n")
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
    assert [(page.count("```python"), page.count("\n## ")) for page in PAGES] == [(7, 7), (6, 6)]
    assert len(BLOCKS) == 13


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


def test_trainers_find_pictures_and_labels(place, monkeypatch):
    """The commands run; each configuration names files that exist. The trainers themselves are not installed."""
    monkeypatch.chdir(place)
    export, links, *configurations = re.findall(r"```(?:bash|python)\n(.*?)```", TRAINERS, re.DOTALL)
    command, *trainings = export.splitlines()
    for line, kind in zip(trainings, ("yolo-pose", "yolo-seg", "yolo-obb"), strict=True):
        _, task, _, file, *_ = line.split()
        data = Path(file.removeprefix("data="))
        simgrab(
            command.replace("yolo-pose", kind).replace("runs/pose", str(data.parent)).split()[1:], standalone_mode=False
        )
        keys = yaml.safe_load(data.read_text())
        assert keys["task"] == task
        assert all(any((data.parent / keys[split]).glob("*.jpg")) for split in ("train", "val", "test"))
    subprocess.run(["bash", "-ec", links], check=True)
    given = []
    yolox = SimpleNamespace(Exp=object)
    rfdetr = SimpleNamespace(RFDETRNano=lambda: SimpleNamespace(train=lambda **options: given.append(options)))
    monkeypatch.setitem(sys.modules, "yolox.exp", yolox)
    monkeypatch.setitem(sys.modules, "rfdetr", rfdetr)
    names = {}
    for block in configurations:
        exec(block, names)
    assert names["val_evaluator"]["ann_file"] == "runs/coco/annotations/instances_val2017.json"
    roots = {names["Exp"]().data_dir, given[0]["dataset_dir"], names["grab"]["data_root"].rstrip("/")}
    assert (roots, given[0]["dataset_file"]) == ({"runs/coco"}, "coco")
    for split in ("train2017", "val2017"):
        coco = json.loads(Path(f"runs/coco/annotations/instances_{split}.json").read_bytes())
        assert coco["images"]
        assert all((Path("runs/coco") / split / image["file_name"]).is_file() for image in coco["images"])

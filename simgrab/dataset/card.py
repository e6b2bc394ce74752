"""The card of a dataset, its ``README.md``: what it shows, how many frames it has, how to load it, its licence."""

from __future__ import annotations

from typing import Any

from simgrab.dataset import yolo
from simgrab.dataset.preview import NAME as SHEET
from simgrab.dataset.summary import Tally
from simgrab.model.scenario import Scenario
from simgrab.model.truth import SPLITS
from simgrab.text import markdown

NAME = "README.md"
HF_SPLITS = {"train": "train", "val": "validation", "test": "test"}
_SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M")  # by the number of digits, from 3 on
_TASKS = ("object-detection", "keypoint-detection", "image-segmentation")
_OWN = (
    'Python: `simgrab.open("FOLDER")`. YOLO trainers read `data.yaml`, readers of COCO `annotations/`. Hugging Face: '
    '`datasets.load_dataset("FOLDER")`.'
)
_LAYOUTS = {
    "simgrab": ("images/{}/**", _OWN),
    "yolo": ("images/{}/**", "YOLO trainers read `data.yaml`."),
    "coco": ("images/{}/**", "Readers of COCO: `annotations/instances_SPLIT.json`."),
    "voc": ("", "Readers of Pascal VOC: `Annotations/`, and the splits in `ImageSets/Main/`."),
    "webdataset": ("shards/{}-*", 'Python: `simgrab.open("URL")`, or `webdataset` with the archives in `shards/`.'),
    "hf": ("data/{}-*", 'Hugging Face: `datasets.load_dataset("FOLDER")`.'),
}
"""By the first word of a layout: files of a split, where Hugging Face ``datasets`` reads them; and how to load it."""


def licence(scenario: Scenario) -> str:
    """State the licence of the pictures."""
    stated = "The pictures are rendered from textures and shapes of simgrab, which are licensed under Apache-2.0."
    if scenario.models:
        names = ", ".join(model.name for model in scenario.models)
        stated += f" They also show {names}, whose licence is not known."
    return stated


def of(scenario: Scenario, core: dict[str, Any], tally: Tally, layout: str) -> bytes:
    """Compose the card, with the front matter that dataset hubs read.

    ``core`` is `simgrab.dataset.manifest.identity`, ``tally`` of all frames, and ``layout`` a format of
    `simgrab.dataset.export`.
    """
    frames, counts = sum(tally.splits), {name: n for name, n in zip(SPLITS, tally.splits, strict=True) if n}
    pattern, loading = _LAYOUTS[layout.partition("-")[0]]
    size = _SIZES[max(len(str(frames)) - 3, 0)]
    head = [f"license: {'other' if scenario.models else 'apache-2.0'}", f'pretty_name: "{scenario.name}"']
    head += ["task_categories:", *(f"- {task}" for task in _TASKS), f"size_categories: [{size}]"]
    head += ["tags: [synthetic, simgrab]"]
    if pattern:
        head += [
            "configs:",
            "- config_name: default",
            *["  drop_labels: true"] * ("images" in pattern),
            "  data_files:",
        ]
        for split in counts:
            name = HF_SPLITS[split] if layout == "hf" else split
            head += [f"  - split: {HF_SPLITS[split]}", f"    path: {pattern.format(name)}"]
    part = f", part of {core['selection']['of_frames']}" if "selection" in core else ""
    facts = {
        "frames": f"{frames} ({', '.join(f'{split} {n}' for split, n in counts.items())}){part}",
        "with a box": f"{tally.labelled}",
        "without a visible grab": f"{frames - tally.labelled - tally.below_least}",
        "of a grab too hidden for a box": f"{tally.below_least}",
        "swing α": f"up to {tally.alpha_max:.2f}°",
        "camera tilt β": f"{tally.beta_min:.2f} to {tally.beta_max:.2f}°",
        "rope": f"{tally.shortest_m:.1f} to {tally.longest_m:.1f} m",
        "seed": f"{scenario.seed}",
        "simgrab": f"{core['simgrab']}",
    }
    table = "labels/*.parquet" if layout == "webdataset" else "labels.parquet"
    varied = any(key.startswith("camera") for keys in scenario.vary for key in keys.split("+"))
    camera = "the camera before it varies: that of a frame is in its row" if varied else "the camera's calibration"
    body = [
        f"# {scenario.name}", markdown(scenario.description),
        "Pictures of a swinging crane grab with exact labels, rendered by [simgrab](https://github.com/simgrab/simgrab).",
        f"![Some frames with their labels]({SHEET})",
        "\n".join(["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in facts.items())]),
        "## How to load", loading, *yolo.stand_ins(counts, layout),
        f"`{table}` has a row for each frame; its metadata describes the columns. `camera.toml` is {camera}. "
        "`simgrab render manifest.json` renders the scene again.",
        "## Licence", markdown(licence(scenario)),
    ]  # fmt: skip
    return "\n".join(["---", *head, "---", "", "\n\n".join(filter(None, body)), ""]).encode()

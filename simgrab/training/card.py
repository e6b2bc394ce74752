"""Model cards: what a net is, what it was made from and how, and how good it is. JSON, and Markdown to read."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from simgrab._version import __version__
from simgrab.dataset.datasets import DatasetIdentity
from simgrab.text import markdown as markdown_text
from simgrab.text import printable
from simgrab.training.folder import write

LICENCE = "Apache-2.0"
PACKAGES = ("torch", "onnx", "onnxruntime", "numpy", "opencv-python-headless")
# Environment variables by which torch and its libraries add up in another order, or with other precision.
CHANGING = (
    "ATEN_CPU_CAPABILITY", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "MKL_CBWR", "ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA",
    "NVIDIA_TF32_OVERRIDE", "TORCH_ALLOW_TF32_CUBLAS_OVERRIDE", "CUBLAS_WORKSPACE_CONFIG",
)  # fmt: skip


@dataclass(frozen=True)
class Card:
    """A model card."""

    name: str  # stem of the file, e.g. `"pose"`
    task: str  # what goes in and what comes out, in a sentence or two
    data: tuple[DatasetIdentity, ...]
    examples: int  # what was trained on, counted as the task counts
    recipe: Mapping[str, Any]  # every setting of the training
    epochs: int  # epochs run; the best one's weights are kept
    seconds: float  # wall time of the training
    metrics: Mapping[str, Any]  # on validation data: overall, and `by_weather`
    # which pretrained weights it began with, and the SHA-256 of the net in between, if any; empty after random ones
    started_from: str = ""
    # of the real frames that were learned from too: `frames`, `videos`, how many `times` each counts, and the
    # `labels_sha256`; empty where there were none
    real: Mapping[str, Any] = field(default_factory=dict)

    def of(self, data: bytes) -> dict[str, Any]:
        """Return the card of a model's bytes, with their digest, the versions and the machine."""
        return asdict(self) | {
            "model_sha256": hashlib.sha256(data).hexdigest(),
            "model_bytes": len(data),
            "machine": machine(str(self.recipe.get("device", "cpu"))),
            "versions": versions(),
            "licence": LICENCE,
        }

    def save(self, model: Path) -> Path:
        """Write the card beside a model: ``pose.onnx`` gets ``pose.json`` and ``pose.md``. Returns the JSON's path."""
        path, content = model.with_suffix(".json"), self.of(model.read_bytes())
        write(path, f"{json.dumps(content, indent=1, ensure_ascii=False)}\n".encode())
        write(path.with_suffix(".md"), markdown(content).encode())
        return path


def versions() -> dict[str, str]:
    """Versions of what made a model."""
    found = {"simgrab": __version__, "python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def machine(device: str = "cpu") -> dict[str, Any]:
    """Say what machine this is, which GPU a device of torch names, and which variables change sums of torch's."""
    found = {"system": platform.platform(terse=True), "processor": platform.machine(), "cores": os.cpu_count() or 1}
    if changing := {name: os.environ[name] for name in CHANGING if name in os.environ}:
        found["environment"] = changing
    if device.startswith("cuda"):
        import torch

        found["accelerator"] = torch.cuda.get_device_name(device)
    return found


def markdown(content: Mapping[str, Any]) -> str:
    """Set a card's content in Markdown."""
    start = content.get("started_from")
    began = f" It began with the weights of `{_code(start)}`." if start else ""
    real = content.get("real")
    also = f" and {real['frames']} real frames of {real['videos']} videos, {real['times']} times each" if real else ""
    alone = "alone" in content["metrics"]
    together = " “alone” is of this net, the rest of all the nets together." if alone else ""
    data = "; ".join(f"{d['frames']} frames of `{_code(d['scenario'])}`, seed {d['seed']}" for d in content["data"])
    machine = content["machine"]
    beside = f" and an {markdown_text(machine['accelerator'])}" if "accelerator" in machine else ""
    lines = [
        f"# {content['name']}",
        "",
        content["task"],
        "",
        f"Trained on {content['examples']} examples, the split `train` of {data}{also},"
        f" for {content['seconds'] / 60:.1f} minutes ({content['epochs']} epochs)"
        f" on {machine['cores']} cores{beside}."
        f" Judged by the split `val` of these.{together}{began}",
        "",
        "| validation | |",
        "|---|---|",
    ]
    lines += [f"| {key.replace('_', ' ')} | {_text(value)} |" for key, value in content["metrics"].items()
              if not isinstance(value, Mapping)]  # fmt: skip
    for title, table in content["metrics"].items():
        if isinstance(table, Mapping) and table:
            lines += ["", *_table(title, table)]
    lines += ["", f"Licence: {content['licence']}. SHA-256 of the model: `{content['model_sha256']}`.", ""]
    return "\n".join(lines)


def _code(text: object) -> str:
    return printable(text).replace("`", "'")


def _table(title: str, table: Mapping[str, Any]) -> list[str]:
    rows = {key: value if isinstance(value, Mapping) else {"value": value} for key, value in table.items()}
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    head = [markdown_text(name.replace("_", " ")) for name in (title, *columns)]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for key, row in rows.items():
        lines.append(f"| {' | '.join([markdown_text(key), *(_text(row.get(column)) for column in columns)])} |")
    return lines


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else markdown_text(value)

"""Hooks of MkDocs: the pages of the site that are not files of ``docs``.

The start page is the README; the files of the project's root are pages too. Notebooks become Markdown, and the
reference of Python is a list of directives, one for each public name.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import simgrab

ROOT = Path(__file__).parents[1]
ROOT_PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
}
ROOT_FILES = {"LICENSE": "LICENSE.txt", "NOTICE": "NOTICE.txt", "CITATION.cff": "CITATION.cff"}
# By heading: names of simgrab, and what their functions take and return.
PYTHON = {
    "Scenes": ["load", "model.scenes", "model.scenario.Scenario"],
    "Frames": ["frames", "FrameDataset", "world.frames.Frame"],
    "Motion of your own": ["Moment", "GrabState", "JibState", "Tilt"],
    "Sensors": ["sensors"],
    "Datasets and videos": [
        "render", "dataset.summary.Summary", "render_video", "dataset.summary.VideoSummary",
        "open", "dataset.datasets.Dataset", "dataset.datasets.LabelledFrame",
        "audit", "judge.audit.proof.Audit",
    ],
    "Measurement": [
        "detect", "instrument.detect.pictures.Detections", "run", "instrument.run.runs.Run",
        "estimate", "Estimate", "Intervals", "instrument.contract.Measurement",
        "model.calibration", "model.layouts",
    ],
    "Evaluation": ["evaluate", "judge.evaluate.values.Evaluation", "check", "judge.check.report.Report", "stress"],
}  # fmt: skip
# Of modules; `simgrab.load` is `model.scenes.load`.
MEMBERS = {
    "model.scenes": ["names", "manifest", "parse_changes", "parse_size", "resized"],
    "model.calibration": ["load", "Calibration"],
    "model.layouts": ["names", "load", "read", "Layout", "Clock"],
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add pages."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=_of_root((ROOT / name).read_text(encoding="utf-8"))))
    for name, file in ROOT_FILES.items():
        files.append(File.generated(config, file, content=(ROOT / name).read_bytes()))
    index = files.get_file_from_path("index.md")
    assert index is not None
    index.content_string = f"---\nhide: [navigation]\n---\n\n{index.content_string}"
    files.append(File.generated(config, "python.md", content=python_page()))
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        page = notebook.src_uri.removesuffix(".ipynb") + ".md"
        files.append(File.generated(config, page, content=notebook_page(Path(str(notebook.abs_src_path)))))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Lead links to files of the project's root, and to notebooks, to their pages."""
    markdown = re.sub(r"\]\(((?:\.\./)*notebooks/[\w-]+)\.ipynb\)", r"](\1.md)", markdown)
    for name, page in (ROOT_PAGES | ROOT_FILES).items():
        markdown = re.sub(rf"\]\((\.\./)((?:\.\./)*){re.escape(name)}(?=[#)])", rf"](\2{page}", markdown)
    return markdown


def _of_root(text: str) -> str:
    """Change the links of a file of the root, so that they are right from ``docs``."""
    text = re.sub(r"\]\(docs/", "](", text)
    for name, page in (ROOT_PAGES | ROOT_FILES).items():
        text = re.sub(rf"\]\({re.escape(name)}(?=[#)])", f"]({page}", text)
    return text


def python_page() -> str:
    """Return the reference of Python; every public name is in it."""
    named = {name for names in PYTHON.values() for name in names}
    missing = set(simgrab.__all__) - {name.removeprefix("model.") for name in named} - {"__version__"}
    assert not missing, f"add to PYTHON: {', '.join(sorted(missing))}"
    lines = ["# Python reference", "", "Angles are in radians and lengths in metres, unless a name says otherwise.", ""]
    for heading, names in PYTHON.items():
        lines += [f"## {heading}", ""]
        for name in names:
            lines.append(f"::: simgrab.{name}")
            if name in MEMBERS:
                lines += ["    options:", f"      members: [{', '.join(MEMBERS[name])}]"]
            lines.append("")
    return "\n".join(lines)


def notebook_page(path: Path) -> str:
    """Return a notebook as Markdown: its text and its code, without outputs."""
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(path.read_text("utf-8"))["cells"]]
    parts = [source if kind == "markdown" else f"```python\n{source}\n```" for kind, source in cells if source]
    parts.insert(1, f"[Download this notebook]({path.name})")
    return "\n\n".join(parts) + "\n"

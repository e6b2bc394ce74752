"""Check that the labels of a dataset are true. Every check is recomputed from the files alone."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pyarrow as pa

from simgrab.dataset import manifest, stored, tables, yolo
from simgrab.dataset.datasets import MANIFEST
from simgrab.dataset.record import FrameRecord
from simgrab.dataset.summary import Tally
from simgrab.errors import DatasetError, PictureError, SimgrabError
from simgrab.io import pictures
from simgrab.io.files import is_visible, sha256
from simgrab.io.parse import parse_json, read_json
from simgrab.judge.audit import identities, silhouettes
from simgrab.judge.audit.proof import Audit, Finding, Findings, Proof
from simgrab.model import scenes
from simgrab.model.masks import MOST_COCO_BYTES, coco_name
from simgrab.model.records import frame_files
from simgrab.model.scenario import OneBody, Scenario, Suspension
from simgrab.model.truth import SPLITS, Row, Truth
from simgrab.runtime.versions import Fingerprint
from simgrab.world.extensions import Effect, Extensions, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs import design_of

# What depends on the renderer. Another fingerprint than the dataset's may differ by so much.
DRAWN = ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px", "visible_fraction", "in_frame_fraction")
OTHER_RENDERER_PX, OTHER_RENDERER_FRACTION, OTHER_RENDERER_PSNR_DB = 1.0, 0.02, 30.0
FIRST_FINDINGS = 5
TABLES = {"labels.parquet", "data.yaml", "camera.toml"}

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class _Dataset:
    path: Path
    manifest: dict[str, Any]
    scenario: Scenario
    schema: pa.Schema
    rows: tuple[Row, ...]


def audit(
    path: str | Path,
    *,
    progress: Progress | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> Audit:
    """Prove a dataset's labels.

    Parameters
    ----------
    path : str or Path
        Folder that `simgrab.dataset.render.render` finished.
    progress : callable, optional
        Called with (proof, frames done, frames in all).
    randomiser, trajectory, effects
        Functions with which the dataset was made, if any; see `simgrab.render`.

    Returns
    -------
    Audit
        Its ``status`` is ``incomplete`` if no second renderer is installed.

    Raises
    ------
    DatasetError
        If there is no finished dataset to audit.
    ExtensionError
        If the dataset was made with other functions.
    """
    data = _read(Path(path))
    extensions = Extensions.of(randomiser, trajectory, effects)
    extensions.refuse_others(data.path / MANIFEST)
    recipe = Recipe(data.scenario, extensions)
    proofs = [
        _manifest_proof(data),
        identities.paper_identities(data.rows),
        identities.poses(data.rows, _hanging(recipe)),
        identities.projections(data.rows),
    ]

    def ticks(name: str) -> Iterator[None]:
        for done in range(len(data.rows)):
            if progress:
                progress(name, done + 1, len(data.rows))
            yield

    with FrameGenerator(recipe) as generator:
        drawing: list[Callable[[], list[Proof]]] = [
            lambda: _redraw(data, generator, ticks("rendering again")),
            lambda: [silhouettes.compare(data.rows, generator, ticks("second renderer"))],
        ]
        for steps in drawing:
            try:
                proofs += steps()
            except SimgrabError:
                raise
            except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError) as problem:
                # Altered data can be too far out to compute with; that is a finding, and no reason to lose the others.
                what = f"contains invalid values ({type(problem).__name__}: {problem})"
                proofs.append(Proof("labels and manifest can be computed with", 1, (Finding("dataset", what),)))
    return Audit(tuple(proofs))


def _read(path: Path) -> _Dataset:
    if not (path / MANIFEST).is_file():
        unfinished = (path / ".partial").exists()
        raise DatasetError(f"{path} holds {'an unfinished' if unfinished else 'no'} simgrab dataset")
    known = read_json(path / MANIFEST, DatasetError)
    try:
        scenario = scenes.load(path / MANIFEST)
    except SimgrabError as problem:
        raise DatasetError(f"{path / MANIFEST}: not a simgrab manifest ({problem})") from None
    rows, schema, _ = frame_files.read_rows(path, Row)
    return _Dataset(path, known, scenario, schema, rows)


def _hanging(recipe: Recipe) -> Callable[[Truth], tuple[Suspension, float]]:
    """Return how a row's grab hangs, and the height of its rope ends, m; each variant is drawn once."""
    known: dict[int, tuple[Suspension, float]] = {}

    def hanging(row: Truth) -> tuple[Suspension, float]:
        number = recipe.variant_number(row.frame)
        if number not in known:
            scenario = recipe.variant(row.frame).scenario
            own = not isinstance(scenario.suspension, OneBody)
            known[number] = scenario.suspension, float(design_of(scenario.grab).terminations[0, 2]) if own else 0.0
        return known[number]

    return hanging


def _manifest_proof(data: _Dataset) -> Proof:
    """Digests, and the copy of the manifest that the labels carry."""
    found, known = Findings(), data.manifest
    text = (data.schema.metadata or {}).get(b"simgrab", b"{}")
    copy = parse_json(text, DatasetError, f"{data.path / 'labels.parquet'}: its metadata is not valid JSON")
    copy = copy if isinstance(copy, dict) else {}
    for key in sorted({*copy, *known} - {"renderer", "files", "manifest_digest", "clamped"}):
        for dotted, a, b in _leaves(key, known.get(key), copy.get(key)):
            found.expect(a == b, f"manifest.json, {dotted}", f"{a!r}, but labels.parquet was written for {b!r}")
    files, wanted = known.get("files"), TABLES | {tables.metadata_name(row.split) for row in data.rows}
    found.expect(isinstance(files, dict) and set(files) >= wanted, "manifest.json, files", "a table is missing")
    found.expect(known.get("digest") == data.scenario.digest(), "manifest.json, digest", "not that of its scenario")
    found.expect(
        known.get("manifest_digest") == manifest.digest(known), "manifest.json, manifest_digest",
        "not that of the other fields: one of them was changed",
    )  # fmt: skip
    for name, digest in files.items() if isinstance(files, dict) else ():
        there = (data.path / name).is_file()
        right = there and sha256(data.path / name) == digest
        found.expect(right, name, "changed since it was written" if there else "missing")
    renderer = known.get("renderer")
    if isinstance(renderer, dict) and {"renderer", "version", "mujoco"} <= set(renderer):
        made_by = Fingerprint(
            *(str(renderer.get(key, "")) for key in ("renderer", "version", "mujoco", "passes"))
        ).digest
        found.expect(renderer.get("fingerprint") == made_by, "manifest.json, renderer", "fields and fingerprint differ")
    else:
        found.expect(False, "manifest.json, renderer", "missing")
    _refuse_strangers(found, data)
    frames = [row.frame for row in data.rows]
    if "selection" in known:  # a part that was exported, of which the manifest counts nothing
        right = frames == sorted(set(frames)) and len(frames) == known.get("frames")
    else:
        right = frames == list(range(data.scenario.frames))
        counts = Tally.of(data.rows, data.scenario).stated(data.scenario).get("clamped")
        found.expect(known.get("clamped") == counts, "manifest.json, clamped", f"the labels' frames are {counts}")
    found.expect(right, "labels.parquet, frame", "rows missing, doubled or moved")
    return found.proof("the manifest agrees with itself, the labels and the files")


def _refuse_strangers(found: Findings, data: _Dataset) -> None:
    """Refuse pictures and labels without a row: a trainer would use them."""
    stems = {f"{row.split}/{row.frame:06d}" for row in data.rows}
    known = {tables.metadata_name(row.split) for row in data.rows}
    for folder in ("images", "labels", "ids", "depth"):
        for file in sorted((data.path / folder).rglob("*")):
            stem = str(file.relative_to(data.path / folder).with_suffix(""))
            own = file.suffix == ".cache"  # a trainer's
            if file.is_file() and not own and is_visible(file, data.path / folder):
                name = str(file.relative_to(data.path))
                found.expect(stem in stems or name in known, name, "not part of this dataset")


def _leaves(key: str, a: Any, b: Any) -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys with their values on both sides."""
    if isinstance(a, dict) and isinstance(b, dict):
        for inner in sorted({*a, *b}):
            yield from _leaves(f"{key}.{inner}", a.get(inner), b.get(inner))
    else:
        yield key, a, b


def _redraw(data: _Dataset, generator: FrameGenerator, tick: Iterator[None]) -> list[Proof]:
    """Render every frame again from the scenario, and compare labels, pictures, masks and exports."""
    labels, pictures, exports = Findings(), Findings(), Findings()
    fingerprint = generator.scene(0).renderer.fingerprint
    same = data.manifest["renderer"].get("fingerprint") == fingerprint.digest
    coco = {split: _coco_by_image(data.path, split) for split in SPLITS}
    for row, _ in zip(data.rows, tick, strict=False):
        if not 0 <= row.frame < data.scenario.frames:
            labels.expect(False, f"frame {row.frame}, frame", "no such frame in the scenario")
            continue
        made = stored.make(generator, row.frame)
        _compare_columns(labels, row, made.record.truth, same)
        for name, picture in made.files.items():
            _compare_picture(pictures, data.path, row, name, picture, same)
        _compare_exports(exports, data, row, made.record, coco[made.record.truth.split], same)
    _compare_metadata(exports, data)
    drawn = "rendered by the same renderer" if same else f"rendered by another renderer ({fingerprint})"
    return [
        labels.proof("every label column follows from the scenario; visible boxes equal the ids'", drawn),
        pictures.proof("every picture is the one that the scenario renders", drawn),
        exports.proof("YOLO and COCO labels and metadata.csv follow from the rows and ids"),
    ]


def _compare_columns(found: Findings, row: Row, expected: Row, same: bool) -> None:
    for name in row.__struct_fields__:
        if name == "image_sha256" and not same:
            continue
        a, b = getattr(row, name), getattr(expected, name)
        slack = 0.0
        if not same and name in DRAWN:
            slack = OTHER_RENDERER_PX if name.endswith("px") else OTHER_RENDERER_FRACTION
        if not same and name == "keypoints":  # visibility hangs on single depth samples
            a, b = (np.delete(np.reshape(v, (-1, 3)), 2, axis=1).ravel().tolist() for v in (a, b))
        found.expect(_close(a, b, slack), f"frame {row.frame}, {name}", f"{a!r}, should be {b!r}")


def _close(a: Any, b: Any, slack: float) -> bool:
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_close(x, y, slack) for x, y in zip(a, b, strict=True))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return bool(abs(a - b) <= slack + 1e-9 * max(1.0, abs(b)))
    return bool(a == b)


def _compare_picture(found: Findings, path: Path, row: Row, name: str, expected: bytes, same: bool) -> None:
    where, file = f"frame {row.frame}, {name}", path / name
    if not file.is_file():
        found.expect(False, where, "missing")
        return
    data = file.read_bytes()
    if name == row.file:
        found.expect(hashlib.sha256(data).hexdigest() == row.image_sha256, where, "differs from its image_sha256")
    if same:
        found.expect(data == expected, where, "not the picture that the scenario renders")
        return
    if name != row.file:  # ids and depth differ at edges, where a mean over the picture is not informative
        return
    try:
        ours, theirs = (pictures.decode(d, file) for d in (expected, data))
    except PictureError as problem:
        found.expect(False, where, problem.reason)
        return
    psnr = cv2.PSNR(ours, theirs) if ours.shape == theirs.shape else 0.0
    found.expect(
        psnr >= OTHER_RENDERER_PSNR_DB, where, f"not the picture that the scenario renders (PSNR {psnr:.1f} dB)"
    )


def _compare_exports(
    found: Findings, data: _Dataset, stored: Row, record: FrameRecord, coco: dict[int, Any], same: bool
) -> None:
    row = record.truth
    name, kind = yolo.name(row), data.scenario.labels.yolo
    file = data.path / name
    text = file.read_bytes() if file.is_file() else None
    if same or kind != "seg":
        right = text == yolo.label(stored, record.mask, data.scenario, kind)
        found.expect(right, f"frame {row.frame}, {name}", "not the label of this row")
    annotation = coco.get(row.frame)
    labelled = tables.is_labelled(row, data.scenario)
    found.expect((annotation is not None) == labelled, f"frame {row.frame}, COCO", "annotated, or not, against its row")
    if annotation is not None and same:
        expected = msgspec.json.decode(msgspec.json.encode(tables.annotation(row, record.mask)))
        for key in expected:
            found.expect(annotation.get(key) == expected[key], f"frame {row.frame}, COCO {key}", "not that of this row")


def _compare_metadata(found: Findings, data: _Dataset) -> None:
    """Compare ``metadata.csv`` of each split with the rows, line by line."""
    for split in sorted({row.split for row in data.rows}):
        file = data.path / (name := tables.metadata_name(split))
        lines = file.read_bytes().split(b"\n") if file.is_file() else []
        frames = ["header", *(f"frame {row.frame}" for row in data.rows if row.split == split), "end"]
        expected = tables.metadata(data.rows, split).split(b"\n")
        for where, line, actual in zip_longest(frames, expected, lines, fillvalue=None):
            found.expect(line == actual, f"{where or 'end'}, {name}", "not that of this row")


def _coco_by_image(path: Path, split: str) -> dict[int, Any]:
    file = path / coco_name(split)
    try:
        annotations = read_json(file, DatasetError, most_bytes=MOST_COCO_BYTES)["annotations"]
        return {a["image_id"]: a for a in annotations}
    except (DatasetError, LookupError, TypeError):
        return {}


def summarise(proofs: Sequence[Proof]) -> list[str]:
    """Lines for people: one a proof, and the first few findings of each that failed."""
    lines = []
    for proof in proofs:
        note = f" ({proof.note})" if proof.note else ""
        lines.append(f"{proof.status:>8}  {proof.claim}: {proof.checked} checks{note}")
        lines += [f"          {finding}" for finding in proof.findings[:FIRST_FINDINGS]]
        if len(proof.findings) > FIRST_FINDINGS:
            lines.append(f"          … and {len(proof.findings) - FIRST_FINDINGS} more")
    return lines

"""Score detectors and the reader on the foreign exam's pictures, condition by condition beside MuJoCo's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from scripts.foreign.making import picture
from scripts.foreign.worlds import DEFAULT_FAMILY, World, with_mujoco
from simgrab.dataset.record import FrameRecord
from simgrab.instrument.detect import Detector
from simgrab.instrument.read import Reader
from simgrab.io import pictures
from simgrab.judge.evaluate import detection, reading
from simgrab.judge.evaluate.detection import Case
from simgrab.judge.evaluate.reading import Read
from simgrab.model import label_arrays as labels
from simgrab.model.scenario import Labels


def record(folder: Path, replacement: str) -> FrameRecord:
    """Read the truth of a world with one replacement."""
    return msgspec.json.decode((folder / f"truth-{replacement}.json").read_bytes(), type=FrameRecord)


def complete(folder: Path, names: Sequence[str]) -> bool:
    """Whether all pictures of some conditions, and MuJoCo's beside, are made."""
    return all(
        (folder / f"truth-{replacement.name}.json").exists() and picture(folder, name) is not None
        for name, replacement in with_mujoco(names).items()
    )


def judged(detector: str, world: World) -> bool:
    """Whether a world's grab is of a kind that a detector claims to find."""
    return detector != "bundled" or world.family == DEFAULT_FAMILY


def score(
    root: Path, worlds: Sequence[World], names: Sequence[str], nets: Mapping[str, Detector], reader: Reader,
    size: tuple[int, int],
) -> dict[str, Any]:  # fmt: skip
    """Run detectors and the reader on the complete worlds' pictures of some conditions and MuJoCo's.

    Returns
    -------
    dict
        ``worlds``: how many are complete; ``incomplete``: the names of the others. ``detectors``: by detector and
        picture, as `simgrab.judge.evaluate.detection.figures` gives, also of each time of day and family of grabs.
        ``digits``: by picture, as `simgrab.judge.evaluate.reading.as_json` gives.
    """
    done = [world for world in worlds if complete(root / world.name, names)]
    cases = dict[str, dict[str, list[Case]]]()
    reads = list[Read]()
    for world in done:
        folder = root / world.name
        rows = {one: record(folder, one.name).truth for one in with_mujoco(names).values()}
        layout = world.scenario(size).display_layout if any(row.rope_text for row in rows.values()) else None
        for name, replacement in with_mujoco(names).items():
            row, path = rows[replacement], picture(folder, name)
            assert path is not None
            rgb = pictures.decode(path.read_bytes(), str(path))
            labelled = labels.is_labelled(row, Labels().least_visible_fraction)
            for key, net in nets.items():
                if judged(key, world):
                    case = Case(row, labelled, world.time, net(rgb), world.name)
                    for group in (name, f"{name}, {world.time}", f"{name}, {world.family}"):
                        cases.setdefault(key, {}).setdefault(group, []).append(case)
            if row.rope_text:
                below = row.rope_text_below or row.rope_text
                reads.append(Read(f"{world.name}, {name}", name, row.rope_text, below, reader.read(rgb, layout)))
    return {
        "worlds": len(done),
        "incomplete": [world.name for world in worlds if world not in done],
        "detectors": {
            key: {group: detection.figures(some) for group, some in sorted(groups.items())}
            for key, groups in cases.items()
        },
        "digits": reading.as_json(reading.by_group(reads)) if reads else [],
    }

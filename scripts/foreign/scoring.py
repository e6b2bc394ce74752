"""Score detectors and the reader on the foreign exam's pictures, condition by condition beside MuJoCo's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from scripts.foreign.making import Agreement, picture
from scripts.foreign.worlds import CONDITIONS, DEFAULT_FAMILY, World, beside, with_mujoco
from simgrab.dataset.stored import Record
from simgrab.instrument.detect import Detector
from simgrab.instrument.read import Reader
from simgrab.io import pictures
from simgrab.judge.evaluate import detection, reading
from simgrab.judge.evaluate.detection import Case
from simgrab.judge.evaluate.reading import Read
from simgrab.model import label_arrays as labels
from simgrab.model.rng import stream
from simgrab.model.scenario import Labels

LEVEL = (0.025, 0.975)
TILE_PX = (480, 270)
GROUPS: Mapping[str, Callable[[World], str]] = {"time": lambda world: world.time, "family": lambda world: world.family}

Values = Mapping[str, float | None]


@dataclass(frozen=True, eq=False)
class Observation:
    """What detectors and the reader output for one picture.

    Attributes
    ----------
    world : World
    cases : dict of str to Case
        By detector, of those that claim to find the world's grab.
    read : Read or None
        None without a display.
    """

    world: World
    cases: Mapping[str, Case]
    read: Read | None


def record(folder: Path, replacement: str) -> Record:
    """Read the truth of a world with one replacement."""
    return msgspec.json.decode((folder / f"truth-{replacement}.json").read_bytes(), type=Record)


def complete(folder: Path, names: Sequence[str]) -> bool:
    """Whether all pictures of some conditions, and MuJoCo's beside, are made."""
    return all(
        (folder / f"truth-{replacement.name}.json").exists() and picture(folder, name) is not None
        for name, replacement in with_mujoco(names).items()
    )


def observations(
    root: Path, world: World, names: Sequence[str], detectors: Mapping[str, Detector], reader: Reader,
    size: tuple[int, int],
) -> dict[str, Observation]:  # fmt: skip
    """Run detectors and the reader on a complete world's pictures of some conditions and MuJoCo's, by their names."""
    folder, result = root / world.name, dict[str, Observation]()
    rows = {one: record(folder, one.name).truth for one in with_mujoco(names).values()}
    layout = world.scenario(size).display_layout if any(row.rope_text for row in rows.values()) else None
    for name, replacement in with_mujoco(names).items():
        row, path = rows[replacement], picture(folder, name)
        assert path is not None
        rgb = pictures.decode(path.read_bytes(), str(path))
        labelled = labels.is_labelled(row, Labels().least_visible_fraction)
        cases = {
            key: Case(row, labelled, world.time, detector(rgb), world.name)
            for key, detector in detectors.items()
            if judged(key, world)
        }
        read = None
        if row.rope_text:
            below = row.rope_text_below or row.rope_text
            read = Read(f"{world.name}, {name}", name, row.rope_text, below, reader.read(rgb, layout))
        result[name] = Observation(world, cases, read)
    return result


def judged(detector: str, world: World) -> bool:
    """Whether a world's grab is of a kind that a detector claims to find."""
    return detector != "bundled" or world.family == DEFAULT_FAMILY


@dataclass(frozen=True, eq=False)
class Sample:
    """Cases of one detector on the pictures of one name, a case for each world.

    Attributes
    ----------
    cases : sequence of Case
    resamples : int
        Of worlds; the same worlds for every sample of as many cases.
    """

    cases: Sequence[Case]
    resamples: int

    @cached_property
    def summary(self) -> Values:
        """See `summarised`."""
        return summarised(self.cases)

    @cached_property
    def resampled(self) -> Sequence[Values]:
        """The same of resampled worlds."""
        count = len(self.cases)
        picks = stream(0, 0, "foreign.bootstrap").integers(max(count, 1), size=(self.resamples, count))
        return [summarised([self.cases[i] for i in some]) for some in picks]

    @cached_property
    def figures(self) -> dict[str, Any]:
        """As `simgrab.judge.evaluate.detection.figures` gives, with ``intervals`` of what `summarised` gives."""
        spread = {key: _interval([one[key] for one in self.resampled]) for key in self.summary}
        return detection.figures(self.cases) | {"intervals": spread}


def summarised(cases: Sequence[Case]) -> Values:
    """COCO's mAP50-95, errors of the centre, and coverage of 95 % intervals; None where there is nothing to count."""
    labelled = [case for case in cases if case.labelled]
    centre = detection.centre_errors([case for case in labelled if case.hits])
    covered = detection.coverage([case for case in labelled if case.hit])
    return {
        "map50_95": detection.average_precision([case for case in cases if case.labelled or case.empty])["map50_95"],
        **{key: centre.get(key) for key in ("median_px", "p95_px", "median_of_diagonal", "p95_of_diagonal")},
        **covered,
    }


def compare(foreign: Sample, mujoco: Sample) -> dict[str, Any]:
    """Score pictures of a condition and MuJoCo's of the same worlds.

    Returns
    -------
    dict
        ``foreign`` and ``mujoco``, each as `Sample.figures` gives, and ``difference``: ``map50_95_less``, by how much
        MuJoCo's mAP50-95 is exceeded, and ``median_ratio`` of the centre's errors, with ``intervals`` over worlds.
    """
    pairs = [_difference(*pair) for pair in zip(foreign.resampled, mujoco.resampled, strict=True)]
    less = _difference(foreign.summary, mujoco.summary)
    spread = {key: _interval([one[key] for one in pairs]) for key in less}
    return {"foreign": foreign.figures, "mujoco": mujoco.figures, "difference": less | {"intervals": spread}}


def _difference(a: Values, b: Values) -> dict[str, float | None]:
    maps, medians = (a["map50_95"], b["map50_95"]), (a["median_px"], b["median_px"])
    return {
        "map50_95_less": None if maps[0] is None or maps[1] is None else maps[0] - maps[1],
        "median_ratio": medians[0] / medians[1] if medians[0] is not None and medians[1] else None,
    }


def _interval(values: Sequence[float | None]) -> tuple[float, float] | None:
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = np.quantile(known, LEVEL)
    return float(low), float(high)


def by_condition(
    worlds: Sequence[Mapping[str, Observation]], names: Sequence[str], detector: str, resamples: int
) -> dict[str, Any]:
    """Compare a detector's cases with MuJoCo's, by condition; "mujoco" itself stands beside the others."""
    cases = {
        name: [found[name].cases[detector] for found in worlds if detector in found[name].cases]
        for name in with_mujoco(names)
    }
    samples = {name: Sample(some, resamples) for name, some in cases.items()}
    pairs = {name: beside(CONDITIONS[name]) for name in names}
    return {name: compare(samples[name], samples[other]) for name, other in pairs.items() if name != other}


def by_group(
    worlds: Sequence[Mapping[str, Observation]], names: Sequence[str], detector: str, resamples: int
) -> dict[str, dict[str, Any]]:
    """Do the same by what `GROUPS` lists, then by its value: time of day and family of grabs."""
    result = dict[str, dict[str, Any]]()
    for kind, key in GROUPS.items():
        members = dict[str, list[Mapping[str, Observation]]]()
        for found in worlds:
            members.setdefault(key(found[names[0]].world), []).append(found)
        result[kind] = {value: by_condition(some, names, detector, resamples) for value, some in members.items()}
    return result


def digits(worlds: Sequence[Mapping[str, Observation]], names: Sequence[str]) -> dict[str, Any]:
    """Score the reader by the pictures' name, as `simgrab.judge.evaluate.reading.as_json` gives; None of no display."""
    result = dict[str, Any]()
    for name in with_mujoco(names):
        reads = [found[name].read for found in worlds]
        some = [read for read in reads if read]
        result[name] = reading.as_json((reading.score(some, name),))[0] if some else None
    return result


def agreement(root: Path, worlds: Sequence[World], replacements: Sequence[str]) -> dict[str, Any]:
    """Sum up how masks and the path tracer's ids agree, by replacement; see `scripts.foreign.making.Agreement`.

    Returns
    -------
    dict
        ``frames`` in which either shows a grab, ``one_sided`` of them in which the other shows none, the count that
        agrees ``within_a_pixel``, and the figures of `Agreement` over all; ``farthest_px`` is None if all are
        one-sided.
    """
    result = {}
    for replacement in replacements:
        paths = [path for world in worlds if (path := root / world.name / f"ids-{replacement}.json").exists()]
        some = [msgspec.json.decode(path.read_bytes(), type=Agreement) for path in paths]
        shown = [one for one in some if one.pixels or one.beyond]
        if shown:
            distances = [one.farthest_px for one in shown if one.farthest_px is not None]
            result[replacement] = {
                "frames": len(shown),
                "one_sided": len(shown) - len(distances),
                "within_a_pixel": sum(one.beyond == 0 for one in shown),
                "least_iou": min(one.iou for one in shown),
                "median_iou": float(np.median([one.iou for one in shown])),
                "farthest_px": max(distances, default=None),
                "pixels": sum(one.pixels for one in shown),
                "pixels_beyond": sum(one.beyond for one in shown),
            }
    return result


def sheet(root: Path, worlds: Sequence[World], name: str, columns: int = 4) -> bytes:
    """Make a contact sheet of a condition's pictures, as JPEG."""
    tiles = []
    for world in worlds:
        path = picture(root / world.name, name)
        if path is not None:
            tile = cv2.resize(cv2.imread(str(path)), TILE_PX, interpolation=cv2.INTER_AREA)
            tiles.append(np.asarray(tile, np.uint8))
    columns = max(min(columns, len(tiles)), 1)
    while len(tiles) % columns or not tiles:
        tiles.append(np.zeros((TILE_PX[1], TILE_PX[0], 3), np.uint8))
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles), columns)]
    _, data = cv2.imencode(".jpg", np.concatenate(rows), [cv2.IMWRITE_JPEG_QUALITY, 88])
    return data.tobytes()

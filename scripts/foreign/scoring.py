"""Score detectors and the reader on the foreign exam's pictures, condition by condition beside MuJoCo's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from scripts.foreign.making import Agreement, picture
from scripts.foreign.worlds import CONDITIONS, World, beside
from simgrab.instrument.detect import Detector
from simgrab.instrument.read import Reader
from simgrab.judge.evaluate import detection, reading
from simgrab.judge.evaluate.detection import Case
from simgrab.judge.evaluate.reading import Read
from simgrab.labels import arrays as labels
from simgrab.layouts import Layout
from simgrab.rng import stream
from simgrab.scenario import Labels
from simgrab.utilities import pictures
from simgrab.world.output.stored import Record

LEVEL = (0.025, 0.975)
TILE_PX = (480, 270)
DEFAULT_GRAB = "four-rope"


@dataclass(frozen=True, eq=False)
class Seen:
    """What was found in one picture.

    Attributes
    ----------
    world : World
    case : Case
    read : Read or None
        None without a display.
    """

    world: World
    case: Case
    read: Read | None


def record(folder: Path, look: str) -> Record:
    """Read what is known of a world's look."""
    return msgspec.json.decode((folder / f"truth-{look}.json").read_bytes(), type=Record)


def complete(folder: Path, names: Sequence[str]) -> bool:
    """Whether all pictures of some conditions, and MuJoCo's beside, are made."""
    return all(
        (folder / f"truth-{CONDITIONS[name].look.name}.json").exists()
        and picture(folder, name) is not None
        and picture(folder, beside(CONDITIONS[name])) is not None
        for name in names
    )


def watch(
    root: Path, worlds: Sequence[World], name: str, look: str, detector: Detector, reader: Reader | None,
    layout_of: Callable[[World], Layout | None],
) -> Iterator[Seen]:  # fmt: skip
    """Let a detector, and where given a reader, look at the pictures of one name. Detections are kept beside them."""
    for world in worlds:
        folder = root / world.name
        known, path = record(folder, look), picture(folder, name)
        assert path is not None
        rgb = pictures.decode(path.read_bytes(), str(path))
        row = known.truth
        labelled = labels.is_labelled(row, Labels().least_visible_fraction)
        case = Case(row, labelled, world.time, detector(rgb), world.name)
        read, layout = None, layout_of(world)
        if reader and layout and row.rope_text:
            found = reader.read(rgb, layout)
            read = Read(f"{world.name}, {name}", name, row.rope_text, row.rope_text_below or row.rope_text, found)
        yield Seen(world, case, read)


def judged(detector: str, world: World) -> bool:
    """Whether a world's grab is of a kind that a detector claims to find."""
    return detector != "bundled" or world.family == DEFAULT_GRAB


def compare(theirs: Sequence[Seen], ours: Sequence[Seen], resamples: int) -> dict[str, Any]:
    """Score pictures of a condition and MuJoCo's of the same worlds.

    Returns
    -------
    dict
        ``foreign`` and ``mujoco``, each as `simgrab.judge.evaluate.detection.figures` gives, with ``intervals`` of
        mAP50-95, the centre's median and its 95 % quantile, and ``difference`` of mAP50-95 and the ratio of the
        medians; all by resampling worlds. ``by_time`` has the first by time of day. ``digits``: what was read.
    """
    a, b = [one.case for one in theirs], [one.case for one in ours]
    both = {"foreign": detection.figures(a), "mujoco": detection.figures(b)}
    drawn = [_quick(a, b, picks) for picks in _resampled(len(a), resamples)]
    result: dict[str, Any] = dict(both)
    result["intervals"] = {key: _interval([one[key] for one in drawn]) for key in (drawn[0] if drawn else ())}
    result["difference"] = _quick(a, b, np.arange(len(a)))
    result["by_time"] = {
        time: detection.figures([one.case for one in theirs if one.world.time == time])
        for time in dict.fromkeys(one.world.time for one in theirs)
    }
    reads = [one.read for one in theirs if one.read]
    result["digits"] = reading.as_json((reading.score(reads),)) if reads else None
    return result


def _quick(a: Sequence[Case], b: Sequence[Case], picks: NDArray[np.int64]) -> dict[str, float | None]:
    some, others = [a[i] for i in picks], [b[i] for i in picks]
    maps = [detection.average_precision([c for c in x if c.labelled or c.empty])["map50_95"] for x in (some, others)]
    centres = [detection.centre_errors([c for c in x if c.hits]) for x in (some, others)]
    medians = [centre.get("median_px") for centre in centres]
    return {
        "map50_95": maps[0],
        "map50_95_less": None if None in maps else maps[0] - maps[1],  # type: ignore[operator]
        "median_px": medians[0],
        "p95_px": centres[0].get("p95_px"),
        "median_ratio": medians[0] / medians[1] if medians[0] and medians[1] else None,
    }


def _resampled(count: int, resamples: int) -> Iterator[NDArray[np.int64]]:
    if count:
        yield from stream(0, 0, "foreign.bootstrap").integers(count, size=(resamples, count))


def _interval(values: Sequence[float | None]) -> tuple[float, float] | None:
    known = [value for value in values if value is not None]
    if not known:
        return None
    low, high = np.quantile(known, LEVEL)
    return float(low), float(high)


def agreement(root: Path, worlds: Sequence[World], looks: Sequence[str]) -> dict[str, Any]:
    """Sum up how masks and the path tracer's ids agree, by look; see `scripts.foreign.making.Agreement`."""
    result = {}
    for look in looks:
        paths = [path for world in worlds if (path := root / world.name / f"ids-{look}.json").exists()]
        some = [msgspec.json.decode(path.read_bytes(), type=Agreement, strict=False) for path in paths]
        shown = [one for one in some if one.pixels]
        if shown:
            result[look] = {
                "frames": len(shown),
                "within_a_pixel": sum(one.beyond == 0 for one in shown),
                "least_iou": min(one.iou for one in shown),
                "median_iou": float(np.median([one.iou for one in shown])),
                "farthest_px": max(one.farthest_px for one in shown),
                "pixels": sum(one.pixels for one in shown),
                "pixels_beyond": sum(one.beyond for one in shown),
            }
    return result


def table(detector: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown of one detector's comparisons by condition."""
    lines = [
        "| condition | grabs | recall | mAP50-95 | by MuJoCo | difference | centre: median, 95 % | by MuJoCo | "
        "95 % intervals cover: box, centre, yaw | boxes on empty frames | digits right, refused |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        f, m, spread, less = row["foreign"], row["mujoco"], row["intervals"], row["difference"]
        digits = row["digits"][0] if row["digits"] else None
        lines.append("| " + " | ".join((
            f"`{name}`", str(f["labelled"]), _counted(f["recall"], f["labelled"], f["recall_interval"]),
            f"{_n(f['map50_95'])}{_spread(spread.get('map50_95'))}", _n(m["map50_95"]),
            f"{_n(less['map50_95_less'], '+.3f')}{_spread(spread.get('map50_95_less'), '+.3f')}",
            _centre(f), _centre(m), ", ".join(_n(v, ".1%") for v in f["coverage"].values()).replace("%", " %"),
            f"{f['false_boxes']} of {f['empty']}{_percent(f['false_interval'])}", _digits(digits),
        )) + " |")  # fmt: skip
    return f"**{detector}**\n\n" + "\n".join(lines) + "\n"


def _n(value: float | None, how: str = ".3f") -> str:
    return "–" if value is None else format(value, how)


def _spread(interval: tuple[float, float] | None, how: str = ".3f") -> str:
    return "" if interval is None else f" ({interval[0]:{how}} to {interval[1]:{how}})"


def _percent(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else f" ({100 * interval[0]:.1f} to {100 * interval[1]:.1f} %)"


def _counted(share: float | None, of: int, interval: tuple[float, float] | None) -> str:
    return "–" if share is None else f"{round(share * of)} of {of}{_percent(interval)}"


def _centre(figures: Mapping[str, Any]) -> str:
    centre = figures["centre"]
    return f"{centre['median_px']:.1f} px, {centre['p95_px']:.1f} px" if centre["frames"] else "–"


def _digits(score: Mapping[str, Any] | None) -> str:
    if not score:
        return "–"
    right, refused = score["digits_right"], score["digits_refused"]
    return f"{right['count']} of {right['of']}, {refused['count']} of {refused['of']}"


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

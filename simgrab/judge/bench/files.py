"""A season's files: what methods may see, and the truth apart from it.

``clips`` holds a video and a camera file of each clip, ``season.json`` and ``targets.csv``. ``truth`` holds each clip's
truth table and manifest, and the season with its seed and salt.
"""

from __future__ import annotations

import csv
import functools
import io
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import BenchError
from simgrab.geometry import Array
from simgrab.judge.bench.season import VERSION, Clip, Season
from simgrab.utilities import parquet
from simgrab.utilities.destination import locked_folder, writing
from simgrab.utilities.files import write
from simgrab.utilities.parse import cannot, read_json
from simgrab.utilities.processes import Pool
from simgrab.utilities.strict import convert
from simgrab.world.output.video.render import render_video

CLIPS, TRUTH, SEASON, TARGETS = "clips", "truth", "season.json", "targets.csv"
_SIDES = (".mp4", ".camera.toml", ".parquet", ".manifest.json")  # the last one says that a clip is finished


@dataclass(frozen=True, eq=False)
class Target:
    """One clip's frames and their truth.

    Attributes
    ----------
    clip : str
    times : ndarray, shape (n,)
        Time stamps in the video, s.
    alpha : ndarray, shape (n,)
        True swing angle, rad; NaN where no grab is present.
    """

    clip: str
    times: Array
    alpha: Array

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Frames that are scored: those with a grab, shape (n,)."""
        return np.isfinite(self.alpha)


def prepare(
    season: Season, folder: Path, *, workers: int = 1, progress: Callable[[int, int], None] | None = None
) -> None:
    """Render a season's clips; run again, it goes on where it was interrupted.

    Parameters
    ----------
    season : Season
    folder : Path
    workers : int
        Processes, each of which renders a clip at a time.
    progress : callable, optional
        Called with (clips done, clips in all).

    Raises
    ------
    BenchError
        If the folder holds another season, or cannot be written.
    """
    secret = folder / TRUTH / SEASON
    if secret.exists() and season_of(folder) != season:
        raise BenchError(f"{folder} holds another season than {season.name}; choose another --out")
    with locked_folder(folder, BenchError, who="simgrab bench"), writing(folder, BenchError):
        for part in (CLIPS, TRUTH):
            (folder / part).mkdir(exist_ok=True)
        write(secret, _json(msgspec.to_builtins(season)))
        missing = [clip for clip in season.clips if not _finished(folder, clip)]
        done = len(season.clips) - len(missing)
        work = functools.partial(_render, season, folder)
        if workers > 1 and len(missing) > 1:
            with Pool(min(workers, len(missing))) as pool:
                for count, _ in enumerate(pool.map(work, missing, name=lambda clip: f"clip {clip.name}"), done + 1):
                    _report(progress, count, len(season.clips))
        else:
            for count, clip in enumerate(missing, done + 1):
                work(clip)
                _report(progress, count, len(season.clips))
        shutil.rmtree(folder / ".work", ignore_errors=True)
        write(folder / CLIPS / TARGETS, _targets(targets(folder)))
        about = {"name": season.name, "version": VERSION, "commitment": season.commitment}
        write(folder / CLIPS / SEASON, _json(about | {"clips": [clip.name for clip in season.clips]}))


def _report(progress: Callable[[int, int], None] | None, done: int, total: int) -> None:
    if progress:
        progress(done, total)


def _finished(folder: Path, clip: Clip) -> bool:
    return all(_place(folder, clip, side).exists() for side in _SIDES)


def _place(folder: Path, clip: Clip, side: str) -> Path:
    return folder / (CLIPS if side in _SIDES[:2] else TRUTH) / f"{clip.name}{side}"


def _render(season: Season, folder: Path, clip: Clip) -> None:
    work = folder / ".work" / f"{clip.name}.mp4"
    work.parent.mkdir(exist_ok=True)
    if not work.with_suffix(_SIDES[-1]).exists():
        render_video(season.scenario(clip), work, resume=True)
    for side in _SIDES:
        work.with_suffix(side).replace(_place(folder, clip, side))


def season_of(folder: Path) -> Season:
    """Season that was prepared in a folder.

    Raises
    ------
    BenchError
        If there is none, or its seed and salt are not those that were committed to.
    """
    path = folder / TRUTH / SEASON
    season = convert(read_json(path, BenchError), Season, BenchError, path)
    public = folder / CLIPS / SEASON
    if public.exists() and (committed := read_json(public, BenchError).get("commitment")) != season.commitment:
        raise BenchError(
            f"{path}: seed and salt give {season.commitment[:12]}…, {public} commits to {committed!s:.12}…"
        )
    return season


def clips_of(folder: Path) -> tuple[str, ...]:
    """Names of the clips that methods are given, from what they may see."""
    found = read_json(folder / CLIPS / SEASON, BenchError)
    if not isinstance(found, Mapping) or found.get("version") != VERSION:
        raise BenchError(f"{folder / CLIPS / SEASON}: not a season of version {VERSION}")
    return tuple(str(name) for name in found["clips"])


def targets(folder: Path) -> tuple[Target, ...]:
    """Frames and truth of each clip of a prepared season.

    Raises
    ------
    BenchError
        If a truth table is missing or damaged.
    """
    result = []
    for clip in season_of(folder).clips:
        path = _place(folder, clip, ".parquet")

        def refusal(why: str, path: Path = path) -> BenchError:
            return BenchError(f"{path}: not the truth of a clip ({why})")

        columns = ["pts_s", "alpha_deg", "present"]
        rows = parquet.rows(parquet.read_table(path, refusal, columns=columns), refusal, cannot(path))
        alpha = [row["alpha_deg"] if row["present"] else np.nan for row in rows]
        times = np.array([row["pts_s"] for row in rows], float)
        result.append(Target(clip.name, times, np.deg2rad(np.array(alpha, float))))
    return tuple(result)


def _targets(found: tuple[Target, ...]) -> bytes:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["clip", "frame", "time_s"])
    for target in found:
        table.writerows((target.clip, frame, f"{time:.6f}") for frame, time in enumerate(target.times.tolist()))
    return text.getvalue().encode()


def _json(value: object) -> bytes:
    return json.dumps(value, indent=1).encode() + b"\n"

"""A season's files: the inputs of methods, and the truth apart from them.

``clips`` holds a video and a camera file of each clip, ``season.json`` and ``targets.csv``. ``truth`` holds each clip's
truth table and manifest, and the season with its seed and salt. Where the season has sensors, ``clips`` has a folder of
each clip with what they report, and ``truth`` one with the truth of it.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import io
import json
import secrets
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import sensor_files, sensors
from simgrab.dataset.pool import SILENT_S, memory_bytes, vet
from simgrab.dataset.tables import into
from simgrab.dataset.video.render import render_video
from simgrab.errors import BenchError, RecordError
from simgrab.io import parquet
from simgrab.io.destination import locked_folder, writing
from simgrab.io.files import write
from simgrab.io.parse import cannot, opened, read_bytes, read_json
from simgrab.io.strict import Checked, convert
from simgrab.judge.evaluate.swings import HARDLY, SURELY
from simgrab.lab.bench.season import VERSION, Season, SeasonClip, check_sensors
from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario
from simgrab.runtime import machine
from simgrab.runtime.processes import Pool, tick
from simgrab.world import gl
from simgrab.world.extensions import Recipe

Meta = msgspec.Meta
Name = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9-]*\Z", max_length=100)]  # of a clip, and so of its files
CLIPS, TRUTH, SEASON, TARGETS = "clips", "truth", "season.json", "targets.csv"
_WORK = ".work"
MOST_ATTEMPTS = 20
LEAST_FRAMES = 300  # of a clip with an alarm: the grab is carried back by then
MOST_TRUTH_BYTES = 100_000_000  # of a clip
MOST_SENSOR_BYTES = 2**32  # of a file
_SIDES = (".mp4", ".camera.toml", ".parquet", ".manifest.json")  # the last one says that a clip is finished


@dataclass(frozen=True, eq=False)
class ClipTruth:
    """One clip's frames and their truth."""

    clip: str
    times: Array  # (n,), time stamps in the video, s
    alpha: Array  # (n,), true swing angle, rad; NaN where no grab is present

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Frames that are scored: those with a grab, shape (n,)."""
        return np.isfinite(self.alpha)


class Published(Checked, frozen=True):
    """What is public of a season: ``season.json`` beside the clips."""

    error = BenchError

    name: str
    version: str
    commitment: str  # SHA-256 of the season, seed and salt included
    truth_sha256: str  # of all truth tables, one after another, and of the truth of the sensors
    # number of frames of each clip
    clips: Annotated[dict[Name, Annotated[int, Meta(ge=1, le=1_000_000)]], Meta(min_length=1)]
    sensors: tuple[str, ...] = ()  # of `simgrab.lab.bench.season.SENSORS`
    # of what the sensors of each clip report: all files in the order of their names, each after its name
    sensors_sha256: dict[Name, str] = msgspec.field(default_factory=dict)

    def check(self) -> None:  # noqa: D102
        check_sensors(self.sensors)
        if self.sensors and self.sensors_sha256.keys() != self.clips.keys():
            raise ValueError("sensors_sha256: must have the same clips as clips")
        if self.version != VERSION:
            raise ValueError(f"version: {self.version!r}; this simgrab has version {VERSION!r} of the clips")


def prepare(
    season: Season, folder: Path, *, workers: int | None = None, progress: Callable[[int, int], None] | None = None
) -> None:
    """Render a season's clips; run again, it goes on where it was interrupted.

    There are as many processes, each of which renders a clip at a time, as cores and memory allow unless ``workers`` is
    given. ``progress`` is called with (clips done, clips in all). Raises `BenchError` if the folder holds another
    season or clips of another version, or cannot be written, or if a clip cannot have the swing that its name promises.
    """
    if season.frames < LEAST_FRAMES and any(clip.swing == "alarm" for clip in season.clips):
        raise BenchError(f"frames: {season.frames}; clips with an alarm need some 480")
    scenarios = [season.scenario(clip) for clip in season.clips]  # refuses a size or a length that no clip can have
    with locked_folder(folder, BenchError, who="simgrab bench"), writing(folder, BenchError):
        secret = folder / TRUTH / SEASON
        if secret.exists() and _season(secret) != season:
            raise BenchError(f"{folder} holds another season; choose another --out")
        for part in (CLIPS, TRUTH):
            (folder / part).mkdir(exist_ok=True)
        write(secret, as_json(season))
        missing = [clip for clip in season.clips if not _finished(season, folder, clip)]
        missing.sort(key=lambda clip: clip.swing != "alarm")  # those that too few frames make impossible first
        each = memory_bytes(Recipe(scenarios[0])) + sensors.memory_bytes(season.with_sensors(scenarios[0]))
        most = machine.free_bytes() // each
        workers = max(1, min(workers or machine.cores(), most, len(missing)))
        threads = max(1, machine.cores() // workers)
        with Pool(
            workers, setup=functools.partial(cv2.setNumThreads, threads), environment=gl.threads(threads),
            silent_s=SILENT_S,
        ) as pool:  # fmt: skip
            work = functools.partial(_render, season, folder)
            rendered = pool.map(work, missing, name=lambda clip: f"clip {clip.name}")
            for done, _ in enumerate(rendered, len(season.clips) - len(missing) + 1):
                if progress:
                    progress(done, len(season.clips))
        shutil.rmtree(folder / _WORK, ignore_errors=True)
        found = targets(folder)
        write(folder / CLIPS / TARGETS, _targets(found))
        about = Published(
            season.name, VERSION, season.commitment, _truth_sha256(season, folder),
            {target.clip: len(target.times) for target in found}, season.sensors,
            {clip.name: _folder_sha256(folder / CLIPS / clip.name) for clip in season.clips if season.sensors},
        )  # fmt: skip
        public = msgspec.to_builtins(about)
        if not season.sensors:  # which seasons did not always have
            del public["sensors"], public["sensors_sha256"]
        write(folder / CLIPS / SEASON, as_json(public))


def hidden_like(season: Season, folder: Path) -> Season:
    """Season with a secret seed and salt: those that a folder has already, or new ones."""
    path = folder / TRUTH / SEASON
    known = _season(path) if path.exists() else None
    seed, salt = (known.seed, known.salt) if known else (secrets.randbelow(2**53), secrets.token_hex(16))
    return msgspec.structs.replace(season, seed=seed, salt=salt)


def _finished(season: Season, folder: Path, clip: SeasonClip) -> bool:
    """Whether a clip was rendered; refuses one that this version would not render."""
    if not all(_place(folder, clip, side).exists() for side in _SIDES):
        return False
    path, scenario = _place(folder, clip, _SIDES[-1]), _drawn(season, clip)
    digest = read_json(path, BenchError).get("digest")
    if digest != scenario.digest():
        raise BenchError(f"{path}: rendered by another version of simgrab; choose another --out")
    return all(_sensor_file(folder, clip, name).exists() for name in sensor_files.names(season.with_sensors(scenario)))


def _drawn(season: Season, clip: SeasonClip) -> Scenario:
    """Scenario of a clip, drawn until its swing is what the clip's name promises: beyond 10.5°, or below 9.5°."""
    for attempt in range(MOST_ATTEMPTS):
        scenario = season.scenario(clip, attempt)
        found = vet(Recipe(scenario))
        largest = max(projection.moment.grab.alpha for projection in found.projections.values())
        if largest > SURELY if clip.swing == "alarm" else largest < HARDLY:
            return scenario
    raise BenchError(f"clip {clip.name}: no such swing within {season.frames} frames; some 480 are needed for an alarm")


def _place(folder: Path, clip: SeasonClip, side: str) -> Path:
    return folder / (CLIPS if side in _SIDES[:2] else TRUTH) / f"{clip.name}{side}"


def _sensor_file(folder: Path, clip: SeasonClip, name: str) -> Path:
    """Where a sensor's file lies, of the name that it has in a dataset: ``sensors/clip_000/imu0/data.csv``."""
    part, _, name = name.split("/", 2)
    return folder / (CLIPS if part == "sensors" else TRUTH) / clip.name / name


def _render(season: Season, folder: Path, clip: SeasonClip) -> None:
    """Render a clip and record its sensors, and then move all files to where they belong, the manifest last."""
    work = folder / _WORK / f"{clip.name}.mp4"
    moves = {work.with_suffix(side): _place(folder, clip, side) for side in _SIDES}
    scenario = _drawn(season, clip)
    if not all(one.exists() or other.exists() for one, other in moves.items()):
        work.parent.mkdir(exist_ok=True)
        render_video(scenario, work, resume=True, progress=lambda _done, _total: tick())
    recorded = work.with_suffix("")
    for name in sensors.write(Recipe(season.with_sensors(scenario)), into(recorded), tick):
        path = _sensor_file(folder, clip, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        (recorded / name).replace(path)
    for one, other in moves.items():
        if one.exists():
            one.replace(other)


def season_of(folder: Path) -> Season:
    """Season that was prepared in a folder, with its secrets.

    Raises `BenchError` if there is none, or if seed, salt or truth are not those that were committed to.
    """
    path = folder / TRUTH / SEASON
    season = _season(path)
    if (folder / CLIPS / SEASON).exists():
        public = published(folder)
        if public.commitment != season.commitment:
            raise BenchError(f"{path}: not the season that {folder / CLIPS / SEASON} commits to")
        if public.truth_sha256 != _truth_sha256(season, folder):
            raise BenchError(f"{folder / TRUTH}: not the truth that {folder / CLIPS / SEASON} commits to")
    return season


def _season(path: Path) -> Season:
    return convert(read_json(path, BenchError), Season, BenchError, path)


def published(folder: Path) -> Published:
    """Read what is public of the season in a folder; raises `BenchError` if there is none, or of another version."""
    path = folder / CLIPS / SEASON
    if not path.exists() and (folder / TRUTH / SEASON).exists():
        raise BenchError(f"{folder}: the season is not complete; simgrab bench prepare with its options goes on")
    return convert(read_json(path, BenchError), Published, BenchError, path)


def _truth_sha256(season: Season, folder: Path) -> str:
    digest = hashlib.sha256()
    for clip in season.clips:
        path = _place(folder, clip, ".parquet")
        digest.update(read_bytes(path, BenchError, most_bytes=MOST_TRUTH_BYTES))
        if season.sensors:
            digest.update(_folder_sha256(folder / TRUTH / clip.name).encode())
    return digest.hexdigest()


def _folder_sha256(folder: Path) -> str:
    """SHA-256 of all files below a folder, each after its name; hidden ones left out."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("[!.]*"), key=Path.as_posix):
        if path.is_file():
            name = path.relative_to(folder).as_posix()
            with opened(path, BenchError, most_bytes=MOST_SENSOR_BYTES) as file:
                digest.update(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()


def sensor_folders(folder: Path, season: Published, clip: str, sensors: Iterable[str]) -> dict[str, Path]:
    """Give the folders of some of a clip's sensors, by the sensors' names.

    Raises `RecordError` if the files of the clip's sensors are not those that the season commits to.
    """
    path = folder / CLIPS / clip
    if _folder_sha256(path) != season.sensors_sha256[clip]:
        raise RecordError(f"{path}: not the sensors' files that {SEASON} commits to")
    return {name: path / name for name in sensors}


def targets(folder: Path) -> tuple[ClipTruth, ...]:
    """Frames and truth of each clip of a prepared season; raises `BenchError` if a table is missing or damaged."""
    result = []
    for clip in _season(folder / TRUTH / SEASON).clips:
        path = _place(folder, clip, ".parquet")

        def refusal(why: str, path: Path = path) -> BenchError:
            return BenchError(f"{path}: not the truth of a clip ({why})")

        columns = ["pts_s", "alpha_deg", "present"]
        rows = parquet.rows(parquet.read_table(path, refusal, columns=columns), refusal, cannot(path))
        alpha = [row["alpha_deg"] if row["present"] else np.nan for row in rows]
        times = np.array([row["pts_s"] for row in rows], float)
        result.append(ClipTruth(clip.name, times, np.deg2rad(np.array(alpha, float))))
    return tuple(result)


def _targets(truths: tuple[ClipTruth, ...]) -> bytes:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["clip", "frame", "time_s"])
    for target in truths:
        table.writerows((target.clip, frame, f"{time:.6f}") for frame, time in enumerate(target.times.tolist()))
    return text.getvalue().encode()


def as_json(value: object) -> bytes:
    """Write plain data or a struct as a JSON file."""
    return json.dumps(msgspec.to_builtins(value), indent=1).encode() + b"\n"

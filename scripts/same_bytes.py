"""Check that ten scenes give the same bytes by this checkout and by another one, such as an earlier commit.

    git worktree add /tmp/earlier 5d4215f
    python -m scripts.same_bytes /tmp/earlier

Datasets, videos with their tables, datasets made by two workers, and datasets that were interrupted and resumed. What
differs is listed by file; files that only one of the two writes are listed apart. What was changed on purpose since
5d4215f is compared as far as it can be: of an MP4, which is written in fragments now, the decoded pictures and their
times; of a manifest all but the digests of ``data.yaml`` and of the video, and its own. The frames of each scene are
made once more by `simgrab.frames` and compared with the dataset.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import av
import msgspec

import simgrab
from simgrab.utilities.pictures import encode

CHANGED_FILES = ("data.yaml", "metadata.csv", ".mp4")
HERE = Path(__file__).parents[1]
SMALL = ["camera.width_px=480", "camera.height_px=270", "image.samples=4", "image.shadow_map_px=1024"]
BUFFERS = ["image.ids=true", "image.depth=true", 'image.format="png"']
# Scene, frames, further keys, flags; with "video" the frames go into a video as well.
CASES: list[tuple[str, int, list[str], list[str]]] = [
    ("quay-day", 6, BUFFERS, ["resume"]),
    ("quay-truck", 4, [], ["workers"]),
    ("hold-coal", 4, BUFFERS, []),
    ("water-side", 4, [], []),
    ("night-light-snow", 4, [], []),
    ("heavy-snow", 4, BUFFERS, []),
    ("rain", 6, [], ["video"]),
    ("work-cycles", 8, ["shutter.exposure_s=0.01", "shutter.rolling_s=0.02"], ["video"]),
    ("qingdao-twin", 8, [], ["workers", "video"]),
    ("training", 4, ["clip.clip_frames=2"], ["workers"]),
]


def make(checkout: Path, out: Path, case: tuple[str, int, list[str], list[str]]) -> None:
    """Render one case by the code of a checkout."""
    name, frames, keys, flags = case
    command = [
        sys.executable,
        "-m",
        "simgrab",
        "render",
        name,
        "--out",
        str(out / "data"),
        "--frames",
        str(frames),
        "--quiet",
    ]
    for key in [*SMALL, *keys]:
        command += ["--set", key]
    command += ["--video", str(out / "clip.mp4")] if "video" in flags else []
    command += ["--workers", "2"] if "workers" in flags else []
    environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1"}
    if "resume" in flags:
        first = subprocess.Popen(
            command, cwd=checkout, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        rows = out / "data" / ".partial" / "rows"
        while first.poll() is None and len(list(rows.glob("*.json"))) < 2:
            pass
        first.kill()
        first.wait()
        command.append("--resume")
    subprocess.run(
        command, cwd=checkout, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def digest(path: Path) -> str:
    """SHA-256 of a file; of those that were changed on purpose, of what must still be the same."""
    if path.suffix == ".mp4":
        total = hashlib.sha256()
        with av.open(str(path)) as video:
            for frame in video.decode(video=0):
                total.update(f"{frame.pts}".encode() + frame.to_ndarray().tobytes())
        return total.hexdigest()
    data = path.read_bytes()
    if path.name.endswith("manifest.json"):
        known = json.loads(data)
        files = {name: value for name, value in known["files"].items() if not name.endswith(CHANGED_FILES)}
        data = json.dumps(known | {"files": files, "manifest_digest": None}).encode()
    return hashlib.sha256(data).hexdigest()


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file by its path."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): digest(path) for path in files if path.name != "data.yaml"}


def in_python(folder: Path) -> tuple[int, int]:
    """Compare `simgrab.frames` with the dataset: its picture files, encoded again, and its rows of labels."""
    data = simgrab.open(folder)
    image, equal = data.scenario.image, 0
    for frame, kept in zip(simgrab.frames(data.scenario), data, strict=True):
        same = encode(frame.rgb[..., ::-1], image.format, image.quality) == kept.content
        truth = msgspec.structs.asdict(frame.truth)
        equal += same and all(value == getattr(kept.truth, name) for name, value in truth.items())
    return equal, len(data)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="Checkout of the other commit.")
    parser.add_argument("--only", nargs="*", help="Names of scenes.")
    chosen = parser.parse_args()
    failed = False
    for case in CASES:
        if chosen.only and case[0] not in chosen.only:
            continue
        with tempfile.TemporaryDirectory() as temporary:
            ours, theirs = Path(temporary, "a"), Path(temporary, "b")
            for checkout, out in ((HERE, ours), (chosen.other, theirs)):
                out.mkdir()
                make(checkout, out, case)
            a, b = digests(ours), digests(theirs)
            equal, count = in_python(ours / "data")
        differing = [name for name in a if name in b and a[name] != b[name]]
        alone, missing = sorted(set(a) - set(b)), sorted(set(b) - set(a))
        failed |= bool(differing) or equal != count or bool(missing)
        kinds = " ".join(case[3]) or "plain"
        print(f"{case[0]:18s} {kinds:14s} {len(set(a) & set(b)):3d} files in both, differing: {differing or 'none'}")
        print(f"{'':33s} {equal} of {count} frames equal in Python, missing: {missing or 'none'}")
        print(f"{'':33s} new: {alone or 'none'}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()

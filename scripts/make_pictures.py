"""Make the pictures of README and docs: ``scripts/python -m scripts.make_pictures [NAME ...]``, by default all of them.

Those of the pages of `simgrab browse` and `simgrab studio` need Chromium. The film's 30 s are `alarm-cycles` from 89 s
on, in real time: the grab is hoisted, slewed and braked too hard. ``sheets`` are for looking at: contact sheets of 24
random grabs of each kind, closed to open, on ropes of 8 to 35 m, in runs/sheets.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import click
import cv2
import msgspec
import numpy as np
from click.testing import CliRunner
from numpy.typing import NDArray

import simgrab
from scripts.chromium import Page, page
from simgrab.cli import cli
from simgrab.cli import main as run
from simgrab.dataset import preview
from simgrab.io.pictures import encode, read
from simgrab.model import label_arrays as labels
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.grab import Grab
from simgrab.model.scenario.surroundings import Kind
from simgrab.model.truth import Row

Picture = NDArray[np.uint8]

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SHOWN = {"quay-day": 6, "quay-truck": 3, "hold-coal": 5, "hold-grain": 2, "water-side": 4, "paper-ideal": 1}
WEATHERS = {
    "calm-day": 5, "windy-day": 1, "night-light-snow": 5, "heavy-snow": 5, "rain": 5,
    "fog": 5, "dust": 7, "glare": 8, "qingdao-night-snow": 3, "qingdao-heavy-snow": 3,
}  # fmt: skip
WORLDS = 24
TILES, COLUMNS, SIDE_PX = 24, 6, 320  # of the sheets of grabs
ROPES_M, VOLUMES_M3 = (8.0, 35.0), (3.0, 20.0)

FILM, FILM_SIZE, FILM_WIDTH = "alarm-cycles", (960, 540), 640
START, LABELLED, WEATHERED, MEASURED, END = 800, 845, 900, 972, 1070
FILM_WEATHERS = ("rain", "fog", "heavy-snow", "night-light-snow")
TOUR = (640, 360)
LOOK = ("light", "optics", "shutter", "weather")  # what the bundled weathers change of a picture

MOST_BYTES = 200_000  # of a page's picture
BROWSED = "#sort=-alpha_deg&labels=box,keypoints&range.alpha_deg=2..&range.visible_fraction=0.5.."
EDITED = {
    "name": "port", "description": "Coal on the quay apron, with a display.", "display.layout": "two-by-four",
    "seed": 1, "camera.beta_deg": 4.0, "swing.alpha.sigma_deg": 6.0, "frames": 16,
}  # fmt: skip


def scenes(shown: dict[str, int], file: str) -> None:
    """Make one frame a scene, two abreast, each with its name."""
    frames = ((name, next(iter(simgrab.frames(name, [frame], buffers=False)))) for name, frame in shown.items())
    _save(file, [preview.captioned(_reduced(frame.rgb[..., ::-1], 640), name) for name, frame in frames], 2)


def training() -> None:
    """Make a frame of each of the first worlds of `training`."""
    scenario = simgrab.load("training")
    first = (world * scenario.clip.clip_frames for world in range(1, WORLDS + 1))  # the very first is dense fog
    frames = simgrab.frames(scenario, first, buffers=False)
    _save("training.jpg", [_reduced(frame.rgb[..., ::-1], 320) for frame in frames], 4)


def contact_sheet() -> None:
    """Render the README's command and keep its preview, smaller."""
    scenario = simgrab.load("quay-day", {"camera.beta_deg": 5.0, "swing.alpha.sigma_deg": 2.0, "frames": 16})
    with tempfile.TemporaryDirectory() as folder:
        simgrab.render(scenario, Path(folder) / "sheet")
        _save("preview.jpg", [_reduced(read(Path(folder) / "sheet" / "preview.jpg")[..., ::-1], 1920)], 1)


def assembled() -> None:
    """Make the sheet of assembled grabs, smaller."""
    _save("assembled.jpg", [_reduced(grab_sheet("assembled"), 1200)], 1)


def sheets() -> None:
    """Make a sheet of grabs of each kind in runs/sheets."""
    for kind in get_args(Kind):
        path = ROOT / "runs" / "sheets" / f"{kind}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encode(grab_sheet(kind), "jpeg", 90))


def grab_sheet(kind: str) -> Picture:
    """Render random grabs of a kind, each on a longer rope and with wider jaws than the one before; BGR."""
    from simgrab.world.scenery.grabs import design_of
    from simgrab.world.scenery.grabs.drawn import any_of

    rng = np.random.default_rng(0)
    tiles = []
    for i, grab in enumerate([any_of(kind, rng, VOLUMES_M3) for _ in range(TILES)]):
        rope = float(np.interp(i / (TILES - 1), (0, 1), ROPES_M))
        jaw = float(np.degrees(design_of(grab).max_jaw)) * (i % COLUMNS) / (COLUMNS - 1)
        frame = next(iter(simgrab.frames(_hanging(grab, rope, jaw, seed=i))))
        box = labels.box(frame.truth)
        assert box is not None
        centre, reach = (box[:2] + box[2:]) / 2, 0.55 * float((box[2:] - box[:2]).max())
        scale = SIDE_PX / (2 * reach)
        view = np.array([[scale, 0, SIDE_PX / 2 - scale * centre[0]], [0, scale, SIDE_PX / 2 - scale * centre[1]]])
        tile = cv2.warpAffine(frame.rgb[..., ::-1].copy(), view, (SIDE_PX, SIDE_PX), flags=cv2.INTER_AREA)
        cv2.putText(tile, f"{rope:.0f} m, {jaw:.0f} deg", (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
        tiles.append(tile)
    return _tiled(tiles, COLUMNS)


def _hanging(grab: Grab, rope_m: float, jaw_deg: float, *, seed: int) -> Scenario:
    changes: dict[str, Any] = {
        "frames": 1, "seed": seed, "place": {"model": "hold", "fill": 0.05, "depth_m": 17.0},
        "jib.head_height_m": 33.0, "camera.beta_deg": 3.0, "swing.alpha.sigma_deg": 1.5,
        "swing.yaw_deg": {"dist": "uniform", "low": -180, "high": 180},
    }  # fmt: skip
    for key, value in (("rope_length_m", rope_m), ("jaw_deg", jaw_deg), ("load", float(seed % 2))):
        changes[f"swing.{key}"] = {"dist": "choice", "values": [value], "weights": [1]}
    return msgspec.structs.replace(simgrab.load("quay-day", changes), grab=grab)


def film() -> None:
    """Make the README's film: a swing with its labels, in other weathers, and as the instrument measures it."""
    animation = cv2.Animation()
    animation.frames = [preview.captioned(_reduced(picture, FILM_WIDTH), text) for picture, text in _film()]
    animation.durations = [round(1000 / simgrab.load(FILM).clip.frame_rate_hz)] * len(animation.frames)
    cv2.imwriteanimation(str(DOCS / "film.webp"), animation, [cv2.IMWRITE_WEBP_QUALITY, 34])


def _film() -> Iterator[tuple[Picture, str]]:
    """Give the film's pictures, BGR, each with its line of text."""
    from simgrab.dataset.tables import calibration_of
    from simgrab.instrument.contract import Frame
    from simgrab.instrument.pipeline import assemble
    from simgrab.instrument.run.run import measure
    from simgrab.instrument.run.video import annotate

    scene = simgrab.load(FILM, size=FILM_SIZE)
    frames = list(simgrab.frames(scene, range(START, END), buffers=False))
    for frame in frames[: LABELLED - START]:
        yield frame.rgb[..., ::-1], "Rendered: the grab swings by a known angle"
    for frame in frames[LABELLED - START : WEATHERED - START]:
        row = Row(**msgspec.structs.asdict(frame.truth), split="", file="", image_sha256="")
        labelled = preview.annotate(frame.rgb[..., ::-1], row)[: FILM_WIDTH * FILM_SIZE[1] // FILM_SIZE[0]]
        yield labelled, f"Exact labels: the true swing is {row.alpha_deg:.2f} deg"
    each = (MEASURED - WEATHERED) // len(FILM_WEATHERS)
    for number, name in enumerate(FILM_WEATHERS):
        look = simgrab.load(name).to_dict()
        if look["optics"]["exposure"]["model"] == "auto":
            look["optics"]["exposure"]["lag_s"] = 0.0  # else each part meters all frames from the clip's beginning
        weathered = simgrab.load(FILM, {key: look[key] for key in LOOK}, size=FILM_SIZE)
        first = WEATHERED + number * each
        for frame in simgrab.frames(weathered, range(first, first + each), buffers=False):
            yield frame.rgb[..., ::-1], f"The same swing in other weather: {name}"
    rate = scene.clip.frame_rate_hz
    pictures = [Frame(frame.rgb, number / rate) for number, frame in enumerate(frames)]
    found = measure(pictures, calibration_of(scene), assemble())
    for frame, measured in list(zip(frames, found.measurements, strict=True))[MEASURED - START :]:
        drawn = annotate(frame.rgb, measured)[..., ::-1]
        yield drawn, f"Measured from the pictures alone; the true swing is {frame.truth.alpha_deg:.2f} deg"


def tour() -> None:
    """Make the README's tour: what comes out of four commands, each below its picture."""
    with tempfile.TemporaryDirectory() as folder, page() as shown:
        out = Path(folder)
        pages = {"check smoke": out / "check" / "check.html", "stress offset-along": out / "stress" / "report.html"}
        for command, path in pages.items():
            CliRunner().invoke(cli, [*command.split(), "--out", str(path.parent), "--quiet"], catch_exceptions=False)
        *_, (labelled, _) = itertools.islice(_film(), LABELLED - START + 1)
        *_, (measured, _) = _film()
        tiles = {"render": labelled, "run swing.mp4": measured}
        shown.look(1000, 562)
        for command, path in pages.items():
            shown.open(path.as_uri())
            shown.wait("document.readyState === 'complete' && document.querySelector('figure')")
            shown.evaluate("document.querySelector('figure').scrollIntoView()")
            shown.photograph(out / "page.jpg", quality=95)
            tiles[command] = read(out / "page.jpg")[..., ::-1]
        drawn = [cv2.resize(tile, TOUR, interpolation=cv2.INTER_AREA) for tile in tiles.values()]
        captions = (f"simgrab {command}" for command in tiles)
        _save("tour.jpg", [preview.captioned(*one) for one in zip(drawn, captions, strict=True)], 2)


def browse() -> None:
    """Take the picture of docs/browsing.md: `simgrab browse` over frames of `training`."""
    from simgrab.pages.browse import browse

    with tempfile.TemporaryDirectory() as folder:
        simgrab.render(simgrab.load("training", {"frames": 192}, size=(640, 360)), Path(folder) / "training")
        with browse.serving(browse.open(Path(folder) / "training")) as address, page() as shown:
            shown.look(1280, 800)
            shown.open(f"{address.url}{BROWSED}")
            shown.wait('document.body?.dataset.ready === "yes"')
            shown.wait('[...document.querySelectorAll("#grid img")].slice(0, 16).every((image) => image.complete)')
            shown.evaluate('document.getElementById("name").textContent = "runs/training"')
            _photograph(shown, "browsing.jpg")


def studio() -> None:
    """Take the picture of docs/studio.md: `simgrab studio` on a changed scene."""
    from simgrab.pages.studio import studio
    from simgrab.pages.studio.documents import Documents

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "port.toml"
        path.write_text(simgrab.load("quay-day", EDITED, size=(960, 540)).to_toml(), encoding="utf-8")
        with studio.serving(Documents(path, Path(folder))) as address, page() as shown:
            shown.look(1280, 1010)
            shown.open(address.url)
            shown.wait('document.querySelector("[data-side=a]")?.dataset.small === "false"')
            shown.evaluate("""(() => {
              document.querySelector("[data-layer=keypoints]").click();
              document.getElementById("tab-instrument").click();
              const search = document.getElementById("search");
              search.value = "deg";
              search.dispatchEvent(new Event("input"));
              for (const one of document.querySelectorAll(".section")) one.open = true;
            })()""")
            shown.wait('document.querySelector("#panel-instrument progress")?.value >= 16', 60)
            _photograph(shown, "studio.jpg")


def _photograph(shown: Page, file: str) -> None:
    """Save what a page shows, with the best quality that is small enough."""
    for quality in range(85, 40, -5):
        shown.photograph(DOCS / file, quality=quality)
        if (DOCS / file).stat().st_size <= MOST_BYTES:
            return


def _reduced(picture: Picture, width: int) -> Picture:
    scale = width / picture.shape[1]
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _tiled(tiles: Sequence[Picture], abreast: int) -> Picture:
    return np.vstack([np.hstack(tiles[i : i + abreast]) for i in range(0, len(tiles), abreast)])


def _save(file: str, tiles: Sequence[Picture], abreast: int) -> None:
    (DOCS / file).write_bytes(encode(_tiled(tiles, abreast), "jpeg", 82))


PICTURES: dict[str, Callable[[], None]] = {
    "scenes": lambda: scenes(SHOWN, "scenes.jpg"),
    "weather": lambda: scenes(WEATHERS, "weather.jpg"),
    "training": training,
    "assembled": assembled,
    "preview": contact_sheet,
    "film": film,
    "tour": tour,
    "browse": browse,
    "studio": studio,
    "sheets": sheets,
}


@click.command(help=(__doc__ or "").partition("\n\n")[0])
@click.argument("names", nargs=-1, type=click.Choice([*PICTURES]))
def main(names: tuple[str, ...]) -> None:
    """Make pictures."""
    for name in names or PICTURES:
        PICTURES[name]()
        click.echo(name)


if __name__ == "__main__":
    run(main)

"""Score a reader of digits: on displays laid over pictures of every weather's scene, or on datasets.

    uv run python -m scripts.score_reader [--digits 100000] [--model reader.onnx] [--json scores.json] [DATASET ...]
    uv run python -m scripts.score_reader --fonts DIR [--digits 50000]

With DATASETs only these are read. With ``--fonts`` the digits are laid on in every font of a folder, white with a black
outline, over pictures of every weather's scene, as JPEG; all fonts, and all scenes, have as many. Otherwise see
`simgrab.judge.evaluate.reading_trial` for how displays are laid on and coded: as JPEG of the scene's quality and as
H.264 of 2 and 4 Mbit/s, torn ones apart.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import msgspec
import numpy as np

from simgrab.cli import main as run
from simgrab.instrument.read import BUNDLED, Reader
from simgrab.instrument.run.runs import write
from simgrab.judge.evaluate import reading, reading_trial
from simgrab.judge.evaluate.reading import Read
from simgrab.model import layouts, scenes
from simgrab.model.layouts import Layout
from simgrab.model.scenario import FontFile, Iid
from simgrab.world.camera.faces import face

BACKDROPS = 8  # pictures of each scene
BACKDROP_SEED = 77_001
RATES_MBIT_S = 2.0, 4.0
VIDEO_SHARE = 0.2  # of the digits; the rest are in stills
TORN = 100  # displays of each scene and layout
QUALITY = 95  # of JPEG, for other fonts


def with_display() -> list[str]:
    """Bundled scenes of independent frames that show rope lengths as they are: one for each weather."""
    loaded = ((name, scenes.load(name)) for name in scenes.names())
    return [name for name, scene in loaded if isinstance(scene.swing, Iid) and not scene.vary and scene.display_layout]


def trials(scene: str, digits: int, folder: Path, layout: Layout, reader: Reader, seed: int) -> Iterator[Read]:
    """Read so many digits laid over a scene's pictures, and some torn displays beside."""
    scenario = scenes.load(scene)
    pictures = reading_trial.backdrops(scene, folder, BACKDROPS, BACKDROP_SEED)
    filmed = max(round(digits * VIDEO_SHARE / 8 / len(RATES_MBIT_S)), 1)
    still = max(-(-digits // 8) - filmed * len(RATES_MBIT_S), 0)
    quality = scenario.image.quality
    shown = reading_trial.displays(layout, still, seed)
    made = [(f"JPEG {quality}", reading_trial.stills(pictures, layout, shown, quality))]
    for k, rate in enumerate(RATES_MBIT_S, 1):
        clip = msgspec.structs.replace(scenario.clip, bit_rate_mbit_s=rate, gop_frames=50)
        coded = msgspec.structs.replace(scenario, clip=clip)
        texts = reading_trial.displays(layout, filmed, seed + k)
        made.append((f"H.264 {rate:g} Mbit/s", reading_trial.video(pictures, layout, texts, coded, seed)))
    torn = reading_trial.displays(layout, TORN, seed + 9, torn=True)
    made.append((f"torn, JPEG {quality}", reading_trial.stills(pictures, layout, torn, quality)))
    for name, several in made:
        for i, trial in enumerate(several):
            found = reader.read(trial.rgb, layout)
            where = f"{scene}, {name}, layout of {layout.hoist_px[0]}, number {i}"
            yield Read(where, scene, trial.shown.rope_text, trial.shown.rope_text_below, found)


def score_trials(reader: Reader, digits: int, folder: Path, seed: int, echo: bool = True) -> tuple[reading.Score, ...]:
    """Score ``digits`` digits, as many in each scene and layout."""
    names, kinds = with_display(), layouts.names()
    each = -(-digits // (len(names) * len(kinds)))
    found: list[Read] = []
    for i, scene in enumerate(names):
        start = time.monotonic()
        for j, kind in enumerate(kinds):
            scenario = scenes.load(scene, {"display.layout": kind})
            assert scenario.display_layout is not None
            found += trials(scene, each, folder, scenario.display_layout, reader, seed + 100 * i + 10 * j)
        if echo:
            click.echo(f"{scene}: {len(found)} frames so far, {time.monotonic() - start:.0f} s", err=True)
    return reading.by_group(found)


def score_fonts(reader: Reader, digits: int, folder: Path, fonts: Path, seed: int) -> tuple[reading.Score, ...]:
    """Score ``digits`` digits or more, as many in each font, scene and layout; the groups are the fonts."""
    files = sorted(path for path in fonts.iterdir() if path.suffix.lower() in (".ttf", ".otf"))
    if not files:
        raise click.UsageError(f"{fonts} holds no font; they end in .ttf or .otf")
    names = with_display()
    pictures = {name: reading_trial.backdrops(name, folder, BACKDROPS, BACKDROP_SEED) for name in names}
    shown = {kind: layouts.load(kind) for kind in layouts.names()}
    each = -(-digits // (8 * len(files) * len(names) * len(shown)))
    found: list[Read] = []
    for i, file in enumerate(files):
        font = face(FontFile.of(file))
        for j, (name, (kind, layout)) in enumerate(itertools.product(names, shown.items())):
            texts = reading_trial.displays(layout, each, seed + 100 * i + j)
            for trial in reading_trial.stills(pictures[name], layout, texts, QUALITY, font):
                where = f"{file.name}, {name}, {kind}"
                text = trial.shown.rope_text
                found.append(Read(where, file.stem, text, text, reader.read(trial.rgb, layout)))
    return reading.by_group(found)


def shares(scores: Sequence[reading.Score]) -> str:
    """Markdown: of all digits of each group, the shares that are right, wrong and refused."""
    lines = ["| font | digits | right, % | wrong, % | refused, % |", "|---|---|---|---|---|"]
    for one in scores:
        of, right, read = one.digits_refused.of, one.digits_right.count, one.digits_right.of
        counts = right, read - right, of - read
        lines.append(f"| {one.group} | {of} | {' | '.join(f'{100 * count / of:.2f}' for count in counts)} |")
    return "\n".join(lines)


def milliseconds(reader: Reader, pictures: Sequence[reading_trial.Picture], rounds: int = 50) -> float:
    """Median time of a reading, from picture to lengths, of pictures that take turns."""
    layout, took = layouts.load("two-by-four"), []
    for picture in [*pictures] * rounds:
        start = time.perf_counter()
        reader.read(picture, layout)
        took.append(time.perf_counter() - start)
    return 1e3 * float(np.median(took))


@click.command()
@click.argument("datasets", nargs=-1, type=click.Path(path_type=Path))
@click.option("--split", type=click.Choice(["train", "val", "test"]), help="Of the datasets, only frames of one split.")
@click.option(
    "--fonts", type=click.Path(path_type=Path, file_okay=False), help="Lay digits on in its TTF and OTF files."
)
@click.option("--digits", default=100_000, show_default=True)
@click.option("--model", type=click.Path(path_type=Path), default=BUNDLED, help="Another reader than the bundled one.")
@click.option("--backdrops", type=click.Path(path_type=Path), default=Path("runs/backdrops"), show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the digits.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the scores there as well.")
def main(
    datasets: tuple[Path, ...], split: str | None, digits: int, model: Path, backdrops: Path, seed: int,
    json_path: Path | None, fonts: Path | None,
) -> None:  # fmt: skip
    """Print the table; exit with 1 where less than 99.99 % are right or more than 0.1 % refused, fonts aside."""
    reader = Reader(model)
    if json_path:
        json_path.parent.mkdir(parents=True, exist_ok=True)
    if fonts:
        scores = score_fonts(reader, digits, backdrops, fonts, seed)
        click.echo(shares(scores))
    elif datasets:
        reads = [read for path in datasets for read in reading.read_dataset(path, reader, split=split)]
        scores = reading.by_group(reads)
    else:
        scores = score_trials(reader, digits, backdrops, seed)
        pictures = reading_trial.backdrops("calm-day", backdrops, BACKDROPS, BACKDROP_SEED)
        click.echo(f"eight digits of 1080p in {milliseconds(reader, pictures):.2f} ms (median, one thread)", err=True)
    if not fonts:
        click.echo(reading.table(scores))
    if json_path:
        write(json_path, json.dumps(reading.as_json(scores), indent=1) + "\n")
    if fonts:
        return
    right, refused = scores[-1].digits_right.value or 0.0, scores[-1].digits_refused.value or 0.0
    raise SystemExit(0 if right >= 0.9999 and refused <= 0.001 else 1)


if __name__ == "__main__":
    run(main)

"""Score the bundled detector on altered pictures: `scripts/python -m scripts.looks DATASET...`, from `simgrab render`.

Prints, for each look: grabs found, those of them that are missed as rendered and the other way round; COCO's mAP50-95,
and its change with the 95 % interval over resampled worlds; the centre's error; and false boxes.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import av
import click
import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.cli import main as run
from simgrab.cli._progress import bar
from simgrab.dataset import datasets
from simgrab.instrument.detect import detector
from simgrab.instrument.detect.patches import Picture
from simgrab.judge.evaluate import boxed, detection
from simgrab.judge.evaluate.detection import Case
from simgrab.model.rng import stream

Light = NDArray[np.float32]  # of a picture, (height, width, 3), from 0 to 1 unless noise adds to it
Step = Callable[[Light, np.random.Generator], Light]
Groups = dict[tuple[str, int | None], list[Case]]  # by world
CAST = np.array([1.12, 1.0, 0.72], np.float32)  # of red, green and blue


def cast(light: Light, _rng: np.random.Generator) -> Light:
    """Add a warm cast."""
    return np.minimum(light * CAST, 1.0)


def tone(light: Light, _rng: np.random.Generator) -> Light:
    """Bend the tone curve, and lift black."""
    curve = np.where(light < 0.5, 2 * light**2, 1 - 2 * (1 - light) ** 2)
    return (0.16 + 0.78 * (0.35 * light + 0.65 * curve)).astype(np.float32)


def noise(light: Light, rng: np.random.Generator) -> Light:
    """Add noise to the luminance."""
    return light + 5 / 255 * rng.standard_normal((*light.shape[:2], 1), np.float32)


def colour_noise(light: Light, rng: np.random.Generator) -> Light:
    """Add smooth noise to each colour."""
    return light + 27 / 255 * cv2.GaussianBlur(rng.standard_normal(light.shape, np.float32), (0, 0), 1.0)


def sharpening(light: Light, _rng: np.random.Generator) -> Light:
    """Sharpen strongly, by an unsharp mask."""
    return light + 2.2 * (light - cv2.GaussianBlur(light, (0, 0), 1.6))


def grey(light: Light, _rng: np.random.Generator) -> Light:
    """Take the colours away."""
    return np.repeat(cv2.cvtColor(np.clip(light, 0, 1), cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)


def infrared(light: Light, rng: np.random.Generator) -> Light:
    """Light a grey picture by a lamp beside the lens, a sixth as bright in the corners, with gain and noise.

    Shadows of the sun remain.
    """
    height, width = light.shape[:2]
    v, u = np.mgrid[:height, :width] / width - np.array([height / width / 2, 0.5])[:, None, None]
    lit = grey(light, rng) * np.exp(-(u**2 + v**2) / 0.18)[..., None]
    return noise((lit * 0.3 / max(float(lit.mean()), 1e-3)).clip(0, 1).astype(np.float32), rng)


def blur(sd_px: float) -> Step:
    """Blur by a Gaussian."""
    return lambda light, _rng: cv2.GaussianBlur(light, (0, 0), sd_px)


def low_bit_rate(light: Light, _rng: np.random.Generator) -> Light:
    """Code as a key frame of H.264 with a quantiser of 40, of at most 51."""
    height, width = (side - side % 2 for side in light.shape[:2])
    file, rgb = io.BytesIO(), np.clip(np.rint(255 * light[:height, :width]), 0, 255).astype(np.uint8)
    with av.open(file, "w", format="mp4") as out:
        video = out.add_stream("libx264", rate=25, options={"qp": "40"})
        video.width, video.height, video.pix_fmt = width, height, "yuv420p"
        out.mux(video.encode(av.VideoFrame.from_ndarray(rgb)))
        out.mux(video.encode())
    with av.open(io.BytesIO(file.getvalue()), "r") as coded:
        (frame,) = coded.decode(video=0)
        return (frame.to_ndarray(format="rgb24") / np.float32(255)).astype(np.float32)


HIDDEN = (cast, tone, noise, colour_noise, sharpening)
LOOKS: dict[str, tuple[Step, ...]] = {
    "as rendered": (),
    "hidden look": HIDDEN,
    **{f"its {step.__name__.replace('_', ' ')}": (step,) for step in HIDDEN},
    "grey": (grey,),
    "infrared night": (infrared,),
    **{f"blur of {sd} px": (blur(sd),) for sd in (1, 2, 3, 4)},
    "low bit rate": (low_bit_rate,),
    "sharpening and cast": (cast, sharpening),
}


def altered(rgb: Picture, steps: tuple[Step, ...], rng: np.random.Generator) -> Picture:
    """Give a picture, (height, width, 3), a look."""
    light: Light = rgb.astype(np.float32) / np.float32(255)
    for step in steps:
        light = step(light, rng)
    return np.clip(np.rint(255 * light), 0, 255).astype(np.uint8)


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.argument("paths", metavar="DATASET...", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--look", "looks", multiple=True, type=click.Choice(list(LOOKS)), help="[default: all]")
@click.option("--detector", "name", default="bundled", show_default=True)
def main(paths: tuple[Path, ...], looks: tuple[str, ...], name: str) -> None:
    """Print one row for each look."""
    net, rendered = detector(name), Groups()
    click.echo("| look | found | lost, gained | mAP50-95 | its change | centre: median, 95 % | false boxes |")
    click.echo("|---|---|---|---|---|---|---|")
    for look in dict.fromkeys(("as rendered", *(looks or LOOKS))):
        groups = Groups()
        for path in paths:
            dataset = datasets.read(path)
            with bar(f"{look}, {path}", shown=True) as progress:
                found = []
                for i, frame in enumerate(dataset):
                    found.append(net(altered(frame.rgb, LOOKS[look], stream(0, i, "look"))))
                    progress(i + 1, len(dataset))
            for case in detection.cases(dataset, found):
                groups.setdefault(case.world, []).append(case)
        rendered = rendered or groups
        click.echo(_row(look, groups, rendered))


def _row(look: str, groups: Groups, rendered: Groups) -> str:
    some, plain = ([case for group in every.values() for case in group] for every in (groups, rendered))
    figures, before = detection.figures(some), detection.figures(plain)
    pairs = [(case.hit, other.hit) for case, other in zip(some, plain, strict=True)]
    values, others = (boxed.resampled_precision(list(every.values()), 500) for every in (groups, rendered))
    low, high = np.nanquantile(values - others, (0.025, 0.975))
    change, centre = figures["map50_95"] - before["map50_95"], figures["centre"]
    return (
        f"| {look} | {sum(hit for hit, _ in pairs)} of {figures['labelled']} | {pairs.count((False, True))}, "
        f"{pairs.count((True, False))} | {figures['map50_95']:.3f} | {change:+.3f} ({low:+.3f} to {high:+.3f}) | "
        f"{centre['median_of_diagonal']:.1%}, {centre['p95_of_diagonal']:.1%} | "
        f"{figures['false_boxes']} of {figures['empty']} |"
    )


if __name__ == "__main__":
    run(main)

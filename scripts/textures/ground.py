"""Ground textures: bulk cargo, concrete, sea and ship's plating, each a seamless tile."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from scripts.textures.noise import Image, fractal, ramp, stretch

SIZE = 1024


def lumps(rng: np.random.Generator, *, count: int, fill: float) -> tuple[Image, Image]:
    """Scatter faceted lumps on a tile.

    Parameters
    ----------
    count : int
        Lumps on the tile.
    fill : float
        Mean lump radius over the mean distance of neighbours; 0.3 is loose, 0.7 touches.

    Returns
    -------
    height, tone : ndarray, shape (SIZE, SIZE)
        Height in pixels (0 between lumps), and a value in [0, 1] that differs from facet to facet.
    """
    centre = rng.uniform(0, SIZE, (count, 2))
    radius = SIZE / np.sqrt(count) * fill * rng.lognormal(0.0, 0.35, count)
    row, column = np.indices((SIZE, SIZE), dtype=float)
    warp = 0.35 * SIZE / np.sqrt(count)
    spot = np.stack([row + warp * (fractal(SIZE, rng, slope=2.6) - 0.5), column], axis=-1) % SIZE
    distance, index = cKDTree(centre, boxsize=SIZE).query(spot.reshape(-1, 2), workers=1)
    index = index.reshape(SIZE, SIZE)
    offset = (spot - centre[index] + SIZE / 2) % SIZE - SIZE / 2
    # Every lump is cut by three planes of its own; the lowest one is the facet that shows.
    facets = []
    for _ in range(3):
        lean = rng.normal(0.0, 0.7, (count, 2))
        facets.append(radius[index] * rng.uniform(0.5, 1.0, count)[index] + (offset * lean[index]).sum(-1))
    dome = np.sqrt(np.maximum(radius[index] ** 2 - distance.reshape(SIZE, SIZE) ** 2, 0.0))
    height = np.maximum(np.minimum(dome, np.min(facets, axis=0)), 0.0)
    tone = rng.uniform(0, 1, (3, count))[np.argmin(facets, axis=0), index]
    return height, np.where(height > 0, tone, 0.5)


def bulk(rng: np.random.Generator, layers: list[tuple[int, float]], *, fines: float) -> Image:
    """Brightness in [0, 1] of a heaped lumpy material: facets, crevices, fines; ``layers`` of (count, fill)."""
    height: Image = fines * fractal(SIZE, rng, slope=1.2, low=20)
    tone = 0.5 + 0.35 * (fractal(SIZE, rng, slope=0.6, low=40) - 0.5)
    for count, fill in layers:
        rock, rock_tone = lumps(rng, count=count, fill=fill)
        tone = np.where(rock > height, rock_tone, tone)
        height = np.maximum(height, rock)
    crevice = sum(np.tanh((height - gaussian_filter(height, s, mode="wrap")) / (0.7 * s)) for s in (2.0, 6.0, 16.0))
    grit = fractal(SIZE, rng, slope=0.3, low=60) - 0.5
    return np.asarray(stretch(0.55 * tone + 0.35 * crevice + 0.30 * grit))


def coal(rng: np.random.Generator) -> Image:
    """Run-of-mine coal: black lumps up to a hand's breadth, grey fines, a little brown."""
    light = bulk(rng, [(30000, 0.5), (5000, 0.33), (700, 0.26)], fines=1.5)
    picture = ramp(light, [(0, (15, 15, 16)), (0.45, (41, 41, 42)), (0.85, (70, 70, 71)), (1, (108, 108, 108))])
    dust = 0.5 * fractal(SIZE, rng, slope=2.4, low=3) + 0.5 * fractal(SIZE, rng, slope=1.5, low=12)
    picture += (np.clip(dust - 0.45, 0, 1) * 26)[..., None] * np.array([1.05, 0.96, 0.84])
    return picture


def ore(rng: np.random.Generator) -> Image:
    """Iron-ore fines with some lumps: dull red-brown."""
    light = bulk(rng, [(40000, 0.45), (4000, 0.25), (300, 0.2)], fines=2.5)
    picture = ramp(light, [(0, (43, 30, 27)), (0.5, (87, 63, 55)), (0.9, (115, 87, 76)), (1, (140, 112, 101))])
    damp = fractal(SIZE, rng, slope=2.2, low=4)
    return picture * (0.86 + 0.28 * damp)[..., None]


def grain(rng: np.random.Generator) -> Image:
    """Maize or wheat: fine, pale, dusty, with streaks of chaff."""
    light = bulk(rng, [(60000, 0.5)], fines=2.0)
    picture = ramp(light, [(0, (110, 94, 68)), (0.5, (158, 140, 108)), (1, (195, 180, 148))])
    chaff = 0.6 * fractal(SIZE, rng, slope=1.8, low=6) + 0.4 * fractal(SIZE, rng, slope=2.6, low=3)
    return picture * (0.90 + 0.20 * chaff)[..., None] + (np.clip(chaff - 0.7, 0, 1) * 40)[..., None]


def bauxite(rng: np.random.Generator) -> Image:
    """Bauxite: earthy orange-red fines, pale pisolites."""
    light = bulk(rng, [(50000, 0.45), (9000, 0.3), (500, 0.2)], fines=2.5)
    picture = ramp(light, [(0, (78, 45, 33)), (0.5, (130, 82, 59)), (0.9, (160, 110, 83)), (1, (190, 152, 128))])
    damp = fractal(SIZE, rng, slope=2.2, low=4)
    return picture * (0.84 + 0.28 * damp)[..., None]


def sulphur(rng: np.random.Generator) -> Image:
    """Formed sulphur: pale yellow granules, dusty, grey where dirt has got in."""
    light = bulk(rng, [(60000, 0.5), (6000, 0.25)], fines=2.0)
    picture = ramp(light, [(0, (132, 112, 46)), (0.5, (188, 166, 76)), (1, (224, 208, 134))])
    dirt = np.clip(fractal(SIZE, rng, slope=2.2, low=3) - 0.6, 0, 1)
    return picture * (1 - np.array([0.5, 0.48, 0.3]) * dirt[..., None])


def cracks(rng: np.random.Generator, *, cells: int, width: float) -> Image:
    """Map cracking: 1 on hairlines between ``cells`` cells a tile, fading with noise so that most are broken off."""
    centre = rng.uniform(0, SIZE, (cells, 2))
    spot = np.moveaxis(np.indices((SIZE, SIZE)).astype(float), 0, -1).copy()
    for axis in range(2):
        for slope, reach in ((3.0, 90.0), (1.6, 10.0)):
            spot[..., axis] += reach * (fractal(SIZE, rng, slope=slope, low=2) - 0.5)
    distance, _ = cKDTree(centre, boxsize=SIZE).query((spot % SIZE).reshape(-1, 2), k=2)
    gap = (distance[:, 1] - distance[:, 0]).reshape(SIZE, SIZE)
    seen = np.clip(5 * (fractal(SIZE, rng, slope=2.4, low=2) - 0.6), 0, 1)
    return np.asarray(np.exp(-((gap / width) ** 2)) * seen)


def concrete(rng: np.random.Generator) -> Image:
    """Old dusty concrete at about 1.2 cm a pixel (tile of 12 m)."""
    cloud = fractal(SIZE, rng, slope=2.2, low=2)
    blotch = fractal(SIZE, rng, slope=1.5, low=8)
    speckle = fractal(SIZE, rng, slope=0.4, low=50)
    light = 0.34 * cloud + 0.33 * blotch + 0.33 * speckle
    picture = ramp(
        stretch(light), [(0, (92, 90, 86)), (0.35, (121, 118, 112)), (0.7, (137, 134, 127)), (1, (158, 155, 147))]
    )
    spots = np.clip((fractal(SIZE, rng, slope=1.6, low=14) - 0.80) * 7, 0, 1)
    picture *= 1 - 0.30 * spots[..., None]
    picture *= 1 - 0.40 * cracks(rng, cells=14, width=1.3)[..., None]
    warm = fractal(SIZE, rng, slope=2.6, low=2) - 0.5
    picture *= 1 + 0.035 * warm[..., None] * np.array([1.0, 0.2, -1.0])
    return picture


def water(rng: np.random.Generator) -> Image:
    """Ripples of harbour water from above, without foam (tile of 16 m): sky on the slopes, depth between them."""
    phase = np.fft.fftfreq(SIZE, 1 / SIZE)
    ky, kx = np.meshgrid(phase, phase, indexing="ij")
    k = np.hypot(ky, kx)
    wind = 0.35 + 0.65 * (np.cos(np.arctan2(ky, kx) - 0.5)) ** 2
    amplitude = np.where((k >= 4) & (k <= 300), np.maximum(k, 1.0) ** -1.9 * wind, 0.0)
    amplitude *= 1 - np.exp(-((k / 14) ** 2))
    spectrum = np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * amplitude
    slope_y, slope_x = (np.fft.ifft2(1j * axis * spectrum).real for axis in (ky, kx))
    tilt = slope_x * 0.8 + slope_y * 0.6
    tilt = tilt / tilt.std() + 0.30 * (slope_x**2 + slope_y**2) / (slope_x**2 + slope_y**2).mean()
    cloud = fractal(SIZE, rng, slope=2.6, low=2, high=40)
    light = tilt + 1.2 * (cloud - 0.5)
    deep = [(-2.5, (43, 50, 47)), (-0.6, (55, 63, 59)), (0.5, (65, 73, 69))]
    return ramp(light, [*deep, (1.6, (82, 91, 88)), (3.2, (118, 127, 126))])


def seams(rng: np.random.Generator, *, rows: int, columns: int) -> tuple[Image, Image]:
    """Plates in brick bond: a weld-seam mask and a tone in [0, 1] for each plate."""
    row, column = np.indices((SIZE, SIZE), dtype=float)
    band = SIZE / rows
    which = (row // band).astype(int)
    along = (column + rng.uniform(0, SIZE, rows)[which]) % SIZE
    across = np.abs((row + band / 2) % band - band / 2)
    length = SIZE / columns
    butt = np.abs((along + length / 2) % length - length / 2)
    weld = np.exp(-((np.minimum(across, butt) / 1.4) ** 2))
    tone = rng.uniform(0, 1, (rows, columns))[which, (along // length).astype(int)]
    return weld, tone


def streaks(rng: np.random.Generator, *, length: float) -> Image:
    """Vertical run marks in [0, 1], ``length`` pixels long and fading."""
    source = (rng.uniform(size=(SIZE, SIZE)) > 0.9998).astype(float) * rng.uniform(0.3, 1, (SIZE, SIZE))
    source = gaussian_filter(source, (0.5, 1.8), mode="wrap")
    decay = np.exp(-np.arange(SIZE) / length)
    run = np.fft.irfft(np.fft.rfft(source, axis=0) * np.fft.rfft(decay)[:, None], n=SIZE, axis=0)
    return stretch(run) * (0.5 + 0.5 * fractal(SIZE, rng, slope=1.2, low=10))


def rust(rng: np.random.Generator) -> Image:
    """Colours of rusty steel, (SIZE, SIZE, 3)."""
    light = 0.5 * fractal(SIZE, rng, slope=1.6, low=4) + 0.5 * fractal(SIZE, rng, slope=0.6, low=30)
    return ramp(stretch(light), [(0, (46, 36, 31)), (0.5, (80, 61, 51)), (1, (118, 91, 75))])


def mix(below: Image, above: Image, share: Image) -> Image:
    """Blend two pictures by a mask in [0, 1]."""
    return below + (above - below) * np.clip(share, 0, 1)[..., None]


def deck(rng: np.random.Generator) -> Image:
    """Deck paint, pale so that a tint colours it, worn, with rust at seams and scuffs (tile of 8 m)."""
    weld, tone = seams(rng, rows=4, columns=1)
    grey = 176 + 16 * (tone - 0.5) + 60 * (fractal(SIZE, rng, slope=1.6, low=3) - 0.5)
    picture = np.repeat(grey[..., None], 3, axis=-1) + 24 * (fractal(SIZE, rng, slope=0.4, low=40) - 0.5)[..., None]
    near_weld = gaussian_filter(weld, 5, mode="wrap")
    worn = fractal(SIZE, rng, slope=1.7, low=5) + 0.9 * near_weld
    picture = mix(picture, rust(rng) * 1.25, (worn - 0.80) * 7)
    return picture * (1 - 0.30 * weld[..., None])


def tanktop(rng: np.random.Generator) -> Image:
    """Bare hold bottom: rusty plates, weld seams, scrapes of loader buckets (tile of 10 m)."""
    weld, tone = seams(rng, rows=4, columns=2)
    picture = rust(rng) * (0.92 + 0.16 * tone)[..., None]
    scrape = np.zeros((SIZE, SIZE), np.float32)
    for _ in range(90):
        start = rng.uniform(0, SIZE, 2)
        angle, run = rng.normal(0.3, 0.5), rng.uniform(60, 360)
        for shift_row in (-SIZE, 0, SIZE):
            for shift_column in (-SIZE, 0, SIZE):
                a = start + np.array([shift_column, shift_row])
                b = a + run * np.array([np.cos(angle), np.sin(angle)])
                ends = [(int(p[0]), int(p[1])) for p in (a, b)]
                cv2.line(scrape, ends[0], ends[1], float(rng.uniform(0.2, 0.7)), int(rng.integers(1, 4)), cv2.LINE_AA)
    bright = np.repeat((112 + 40 * fractal(SIZE, rng, slope=1.0))[..., None], 3, axis=-1)
    picture = mix(picture, bright, 0.5 * gaussian_filter(scrape, 0.8, mode="wrap") * fractal(SIZE, rng, slope=1.0))
    return picture * (1 - 0.35 * weld[..., None] + 0.2 * np.roll(weld, 2, axis=0)[..., None])


def hullplate(rng: np.random.Generator) -> Image:
    """Painted ship's plating, pale so that a tint colours it: seams, dents, rust runs (tile of 10 m)."""
    weld, tone = seams(rng, rows=4, columns=1)
    frames = np.cos(np.arange(SIZE) / SIZE * 2 * np.pi * 12)[None, :] * fractal(SIZE, rng, slope=2.4, low=2)
    grey = 182 + 10 * (tone - 0.5) + 9 * frames + 34 * (fractal(SIZE, rng, slope=1.9, low=2) - 0.5)
    picture = np.repeat(grey[..., None], 3, axis=-1) + 14 * (fractal(SIZE, rng, slope=0.4, low=40) - 0.5)[..., None]
    picture = mix(picture, rust(rng) * 1.2, 1.1 * streaks(rng, length=130) ** 1.3)
    patch = fractal(SIZE, rng, slope=1.8, low=6) + 0.5 * gaussian_filter(weld, 4, mode="wrap")
    picture = mix(picture, rust(rng) * 1.15, (patch - 0.88) * 6)
    return picture * (1 - 0.22 * weld[..., None])


TEXTURES: dict[str, Callable[[np.random.Generator], Image]] = {
    "coal": coal,
    "ore": ore,
    "grain": grain,
    "concrete": concrete,
    "water": water,
    "deck": deck,
    "tanktop": tanktop,
    "hullplate": hullplate,
    "bauxite": bauxite,
    "sulphur": sulphur,
}

"""Report how simgrab reads a user's own grab, and what looks wrong with it."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import unescape
from pathlib import Path

import cv2
import msgspec
import numpy as np
import trimesh
from msgspec.structs import replace
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.io.files import write
from simgrab.io.parse import shown
from simgrab.io.pictures import encode
from simgrab.judge import own_jaws
from simgrab.judge.own_jaws import IN_AIR_M, distance
from simgrab.model import scenes
from simgrab.model.geometry import Array
from simgrab.model.scenario import Grab, Mesh, Scenario
from simgrab.reports import html
from simgrab.world import gl
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.from_file import PLATE_M, UNITS, ImportedModel, Piece, design, read, usual_up
from simgrab.world.scenery.model import GRAB, ROPE, build
from simgrab.world.scenery.plan import draw_up
from simgrab.world.trajectory.moment import GrabState, Moment, Tilt

USUAL_SIDES_M, USUAL_KG = (1.2, 7.0), (500.0, 40_000.0)
MANY_FACES = 150_000
_ASIDE = 0.05  # share of the width by which the centre of mass may lie beside the ropes' axis
_COARSE_M = 0.002  # steps of coordinates that show
_EVEN, _UNEVEN, _SLICES = 0.1, 0.03, 50  # along an axis: may be even, differs from another, and how finely measured
_MOST_LISTED = 20  # groups of nodes, and nodes
_HEAVY = 0.5  # share of the mass in one closed surface
_ASSUMED_M = 0.02  # from steel: assumed ends of ropes lie in no ring's middle
_TILE, _AZIMUTHS, _ROPE_M = 480, 4, 12.0
PAGE, PICTURE = "grab.html", "turntable.jpg"


@dataclass(frozen=True, eq=False)
class Understood:
    """A user's own grab as simgrab reads it.

    Attributes
    ----------
    facts : sequence of (str, str)
        Properties that were read: a name and its value with units.
    doubts : sequence of str
        Possible mistakes, a sentence each.
    turntable : ndarray, shape (H, W, 3), uint8
        RGB: closed from all sides, then from above and below, and open where it opens.
    """

    facts: Sequence[tuple[str, str]]
    doubts: Sequence[str]
    turntable: NDArray[np.uint8]

    def save(self, folder: Path, name: str) -> None:
        """Write the page and the picture into a folder."""
        jpeg = encode(self.turntable[..., ::-1], "jpeg", 90)
        folder.mkdir(parents=True, exist_ok=True)
        write(folder / PICTURE, jpeg)
        write(folder / PAGE, html.page("grab.html", name=name, grab=self, jpeg=jpeg).encode())


def page_of(folder: Path) -> str:
    """Return the name of the grab whose page a folder contains; empty if there is none."""
    page = folder / PAGE
    title = re.search("<title>Grab (.*?)</title>", page.read_text(errors="replace")) if page.is_file() else None
    return unescape(title[1]) if title else ""


def scene_of(file: str | Path, changes: dict[str, object] | None = None) -> Scenario:
    """Return a scene with a user's own grab, from a mesh file or from a scene file whose ``[grab]`` is one.

    ``changes`` are dotted keys to values, as for `simgrab.load`. Raises `ScenarioError`.
    """
    path = Path(file)
    if path.suffix.lower() in (".toml", ".json"):
        scene = scenes.load(path, changes)
    else:
        scene = scenes.load("quay-day", {"grab": {"model": "mesh", "file": str(path)}} | (changes or {}))
    if not isinstance(scene.grab, Mesh):
        raise ScenarioError("grab.model", f'{path} has no grab of model = "mesh"')
    return scene


def grab_of(file: str | Path) -> Mesh:
    """Give the grab of `scene_of`."""
    grab = scene_of(file).grab
    assert isinstance(grab, Mesh)
    return grab


def check(scene: Scenario) -> Understood:
    """Read a scene's own grab, look for likely mistakes, and render it from all sides.

    Raises `ScenarioError` if the file cannot be a grab.
    """
    keys = scene.grab
    assert isinstance(keys, Mesh)
    model, reading = _read(keys)
    made = design(keys, reading)
    doubts = _loose(reading) + _doubts_of_file(keys, model, reading) + _doubts(keys, reading.pieces, made)
    hangs = f"{msgspec.to_builtins(scene.suspension)['model']} (suspension.model): one-body leans as its ropes do"
    return Understood([*_facts(keys, model, reading, made), ("hangs as", hangs)], doubts, turntable(scene))


def likely_scale(file: str | Path) -> float:
    """Metres a unit as a model states it, or else by which its longest side is a grab's; 1 if none or several are.

    Raises `ScenarioError` if the file cannot be read.
    """
    grab = Mesh.of(file, scale=UNITS["millimetres"])
    _, reading = _read(grab)
    if reading.contents.unit:
        return UNITS[reading.contents.unit]
    units = float(_sides(reading).max()) / grab.scale
    fits = [scale for scale in UNITS.values() if USUAL_SIDES_M[0] <= units * scale <= USUAL_SIDES_M[1]]
    return fits[0] if len(fits) == 1 else 1.0


def _read(grab: Mesh) -> tuple[models.ModelFile, ImportedModel]:
    model = models.recall(grab.sha256, grab.file, functools.partial(ScenarioError, "grab.file"))
    return model, read(grab, model)


def _sides(reading: ImportedModel) -> Array:
    return np.ptp(np.concatenate([piece.vertices for piece in reading.pieces]), axis=0)


def remarks(grab: Grab) -> list[str]:
    """Return the size of a grab from a file, read by `simgrab.load`, and doubts about size and axes; else nothing."""
    if not isinstance(grab, Mesh):
        return []
    model, reading = _read(grab)
    size = _sides(reading)
    sides = " × ".join(f"{side:.2f}" for side in size)
    stated = f"taken as {sides} m (x, y, z up), with grab.scale = {grab.scale:g}"
    return [stated, *_loose(reading), *_doubts_of_size(size), *_doubts_of_axis(grab, model, reading)]


def _loose(reading: ImportedModel) -> list[str]:
    advice = "it counts in size, mass and boxes. Remove it if it is no part of the grab; else what joins it is missing."
    return [f"{said}: {advice}" for said in reading.loose[0]]


def _extent(design: Design) -> tuple[Array, Array]:
    points = np.concatenate(list(design.points(0.0).values()))
    return points.min(axis=0), points.max(axis=0)


def _metres(values: Sequence[float] | Array) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _listed(parts: list[Piece]) -> str:
    """List nodes that a jaw can name: those that show something, and groups of them, such as ``Jaw (Rod, Shell)``."""
    below: dict[str, set[str]] = {}
    for piece in parts:
        for node in piece.nodes[1:]:
            below.setdefault(node, set()).add(piece.nodes[0])
    alone = sorted({piece.nodes[0] for piece in parts} - set(below))
    groups = [f"{node} ({', '.join(sorted(held)[:4])}{', …' if len(held) > 4 else ''})" for node, held in below.items()]
    left_out = max(len(groups) - _MOST_LISTED, 0) + max(len(alone) - _MOST_LISTED, 0)
    more = [f"and {left_out} more"] if left_out else []
    return ", ".join(sorted(groups)[:_MOST_LISTED] + alone[:_MOST_LISTED] + more)


def _facts(keys: Mesh, model: models.ModelFile, reading: ImportedModel, made: Design) -> list[tuple[str, str]]:
    parts = reading.pieces
    low, high = _extent(made)
    width, length, height = high - low
    # A, from the file's origin
    centre = np.concatenate([piece.vertices for piece in parts]).min(axis=0) - low + reading.origin_m
    mass = made.mass_of(0.0, 0.0)
    up = f"{usual_up(model)} (the format's usual one)" if keys.up == "auto" else keys.up
    others = sorted(set(model.files) - {model.name})
    surfaces = [surface for piece in parts for surface in piece.surfaces]
    closed = sum(surface.closed for surface in surfaces)
    materials = {one.material.name: one.material for piece in parts for one in piece.parts}
    textured = sum(material.texture is not None for material in materials.values())
    painted = "body" in materials
    facts = [
        ("file", f"{model.name}, {sum(map(len, model.files.values())) / 1e6:.1f} MB, SHA-256 {model.sha256}"),
        ("refers to", ", ".join(others) or "no other file"),
        ("scale, up", f"{keys.scale:g} m a unit; {up} points up; turned by {keys.yaw_deg:g}°"),
        ("size", f"{width:.2f} m (x) × {length:.2f} m (y) × {height:.2f} m high"),
        ("triangles", f"{sum(piece.file_faces for piece in parts):,}"),
        ("surfaces", f"{len(surfaces)} separate ones, " + ("all closed" if closed == len(surfaces) else
                     f"of which {closed} are closed; nodes with others are drawn from both sides")),
        ("nodes", _listed(parts)),
        ("materials", f"{len(materials)}, of which {textured} with a texture"
                      + ("; paint_rgb, wear and residue apply" if painted else "")),
        ("left out", "; ".join(reading.contents.unread) or "nothing"),
        ("centre A", f"({_metres(centre)}) m from the file's origin, z up"
                     + (" (at half the height on the ropes' axis)" if keys.centre_m is None else "")),
        ("ropes", f"{keys.ropes}, rope_ends_m = ["
                  + ", ".join(f"[{_metres(end)}]" for end in made.terminations + centre)
                  + "], from the file's origin" + ("" if keys.rope_ends_m else " (assumed: at the top of the middle)")),
        ("jaws", "; ".join(f"{jaw.node}: {f'{jaw.open_deg:g}°' if jaw.open_deg else f'{jaw.stroke_m:g} m'}"
                           for jaw in keys.jaws) or "none: this grab does not open"),
        ("keypoints", f"ends of ropes: {len(made.terminations)}; ends of lips: {sum(map(len, made.lips.values()))}"),
        ("mass", f"{mass.mass:,.0f} kg" + ("" if keys.mass_kg else
                 f" (estimated: closed surfaces as solid steel, others as {1e3 * PLATE_M:g} mm plates)")),
        ("moments of inertia", f"{_metres([i / 1e3 for i in mass.inertia])} t m² about the centre of mass, "
                               f"{mass.centre_z:+.2f} m from A"),
        ("wind", f"Cd·A = {made.cd_a_m2:.1f} m²" + ("" if keys.drag_area_m2 is not None else " (from the outline)")),
    ]  # fmt: skip
    return facts


def _doubts_of_file(keys: Mesh, model: models.ModelFile, reading: ImportedModel) -> list[str]:
    """Return doubts about parts of a file that are missing, not read, or likely meant otherwise."""
    found = []
    for name in model.missing:
        if name.lower().endswith(".mtl"):
            found.append(f"The material library {shown(name)} is not in the model's folder: its materials are painted "
                         "by paint_rgb. Put it beside the model.")  # fmt: skip
        else:
            found.append(f"The texture {shown(name)} is not in the model's folder: it is left out. Put it beside the "
                         "model, and name it by its name alone.")  # fmt: skip
    if keys.finish == "file":
        found += reading.contents.doubts
    unit = reading.contents.unit
    if unit and not np.isclose(keys.scale, UNITS[unit]):
        found.append(f"The file says that it is in {unit}, but scale is {keys.scale:g}: check scale ({UNITS[unit]:g}).")
    coarse = max(_step(shape.vertices) for shape in reading.contents.shapes) * keys.scale
    if coarse > _COARSE_M:
        found.append(f"It lies {np.linalg.norm(reading.origin_m):,.0f} m from the file's origin, where numbers of 32 "
                     f"bits have steps of {coarse:.2g} m: move it to the origin, and export it again.")  # fmt: skip
    return found + _doubts_of_axis(keys, model, reading)


def _step(vertices: Array) -> float:
    """Return the spacing of 32-bit numbers at the farthest coordinate; 0 for other numbers."""
    single = np.asarray(vertices, np.float32)
    return float(np.spacing(np.abs(single).max(initial=0.0))) if (single == vertices).all() else 0.0


def _doubts_of_axis(keys: Mesh, model: models.ModelFile, reading: ImportedModel) -> list[str]:
    """Compare the axes that may point up, if no key states the axis.

    A grab is alike to both sides, but not above and below: the axis along which the steel lies least evenly points up.
    """
    if keys.up != "auto":
        return []
    uneven = {name: _unevenness(reading, axis) for axis, name in enumerate("xyz")}
    if model.format in ("glb", "gltf"):  # our axes of a file with y up: (x, -z, y)
        uneven["y"], uneven["z"] = uneven["z"], uneven["y"]
    usual = usual_up(model)
    other = "z" if usual == "y" else "y"
    stated = f"the steel is uneven by {uneven[usual]:.0%} along {usual}, the format's usual axis, and by "
    stated += f"{uneven[other]:.0%} along {other}"
    if uneven[usual] < _EVEN and uneven[other] > max(2 * uneven[usual], uneven[usual] + _UNEVEN):
        return [f"{other} seems to point up: {stated}. A grab is uneven along the vertical. Give grab.up=\"{other}\" "
                "if the pictures show it on its side."]  # fmt: skip
    if uneven[usual] < max(2 * uneven[other], uneven[other] + _UNEVEN):
        return [f"It is not clear whether {usual} or {other} points up: {stated}. Look at the pictures, and give "
                f"grab.up=\"{usual}\" or grab.up=\"{other}\"."]  # fmt: skip
    return []


def _unevenness(reading: ImportedModel, axis: int) -> float:
    """Return how far the steel along an axis differs from its mirror image: from 0 for equal to at most 1."""
    corners = np.concatenate([piece.solid.triangles[..., axis] for piece in reading.pieces])
    areas = np.concatenate([piece.solid.area_faces for piece in reading.pieces])
    places = corners @ _within(int(np.clip(np.sqrt(2e5 / len(corners)), 1, 40))).T
    weights = np.broadcast_to(areas[:, None], places.shape)
    shares, _ = np.histogram(places, bins=_SLICES, range=(corners.min(), corners.max()), weights=weights)
    below = np.concatenate([[0.0], np.cumsum(shares)]) / max(shares.sum(), 1e-300)
    return float(np.abs(below + below[::-1] - 1.0).max())


def _within(n: int) -> Array:
    """Return the middles of the n² equal triangles that make up a triangle, as shares of its corners, (n², 3)."""
    middles = [(i + a, j + a) for a, m in ((1 / 3, n), (2 / 3, n - 1)) for i in range(m) for j in range(m - i)]
    first, second = np.array(middles).T / n
    return np.stack([first, second, 1.0 - first - second], axis=1)


def _doubts_of_size(size: Array) -> list[str]:
    low, high = USUAL_SIDES_M
    if low <= size.max() <= high:
        return []
    return [f"The longest side is {size.max():.2f} m; grabs have {low} to {high} m: check scale (mm: 0.001)."]


def _doubts(keys: Mesh, parts: list[Piece], made: Design) -> list[str]:
    low, high = _extent(made)
    size = high - low
    found = _doubts_of_size(size)
    if size[2] < 0.35 * size[:2].max():
        found.append("It is much lower than wide: check up.")
    surfaces = [(surface, piece.nodes[0]) for piece in parts for surface in piece.surfaces]
    holes = [surface for surface, _ in surfaces if not surface.closed]
    if holes:
        area = sum(surface.area_m2 for surface in holes) / sum(surface.area_m2 for surface, _ in surfaces)
        nodes = list(dict.fromkeys(node for surface, node in surfaces if not surface.closed))
        names = ", ".join(nodes[:6]) + (", …" if len(nodes) > 6 else "")
        found.append(f"{len(holes)} of {len(surfaces)} surfaces have holes, or edges of more than two faces, in "
                     f"{names} ({area:.0%} of the area): taken as hollow, of {1e3 * PLATE_M:g} mm plates. Close what "
                     "is solid steel.")  # fmt: skip
    m3 = [float(surface.solid.volume) for surface, _ in surfaces]
    heaviest, node = surfaces[int(np.argmax(m3))]
    if heaviest.closed and len(surfaces) > 1 and max(m3) > _HEAVY * sum(m3):
        sides = " × ".join(f"{side:.2f}" for side in np.ptp(heaviest.solid.triangles, axis=(0, 1)))
        found.append(f"A closed surface of {node}, {sides} m, is taken as solid steel, {max(m3) / sum(m3):.0%} of the "
                     "mass. If it is hollow, leave a face open: mass_kg does not move the centre of mass.")  # fmt: skip
    faces = sum(piece.file_faces for piece in parts)
    if faces > MANY_FACES:
        found.append(f"{faces:,} triangles take long to draw; {MANY_FACES:,} are plenty at these distances.")
    frames = made.frames(0.0)
    steel = trimesh.util.concatenate([b.steel.copy().apply_transform(frames[b.name]) for b in made.bodies])
    advice = "check rope_ends_m, in metres from the file's origin, z up" if keys.rope_ends_m else "give rope_ends_m"
    away = [distance(steel, end) for end in made.terminations]
    if max(away) > (IN_AIR_M if keys.rope_ends_m else _ASSUMED_M):
        found.append(f"Ropes end up to {max(away):.2f} m from any steel: {advice}.")
    if made.terminations[:, 2].min() < low[2] + 0.6 * size[2]:
        found.append("The ropes end in the lower part: check up and rope_ends_m.")
    kg = np.array([body.mass_kg for body in made.bodies])
    centres = np.array([trimesh.transform_points([b.solid.center_mass], frames[b.name])[0] for b in made.bodies])
    aside = (kg @ centres / kg.sum())[:2]
    if np.abs(aside).max() > _ASIDE * size[:2].max():
        found.append(f"The centre of mass lies {_metres(aside)} m (x, y) beside the ropes' axis: it would hang askew. "
                     "Give rope_ends_m or centre_m.")  # fmt: skip
    if not USUAL_KG[0] <= kg.sum() <= USUAL_KG[1]:
        found.append(f"A mass of {kg.sum():,.0f} kg is unusual: give mass_kg.")
    found += own_jaws.doubts(keys, made, float(size[:2].max()))
    if not any(map(len, made.lips.values())):
        found.append("There are no keypoints but the rope ends: lips_m gives others.")
    return found


def turntable(scene: Scenario) -> NDArray[np.uint8]:
    """Render a scene's grab from its sides, above and below, and open; RGB, shape (H, W, 3)."""
    import mujoco  # after `simgrab.world`, which chooses the OpenGL that it loads

    bare = scenes.load("quay-day", {"place": {"model": "plain"}, "image.shadow_map_px": 0, "seed": scene.seed})
    staged = replace(bare, grab=scene.grab, jib=scene.jib)
    plan = draw_up(staged)
    low, high = _extent(plan.grab)
    world = build(plan, textured=True)
    data = mujoco.MjData(world.model)
    reach = float(np.linalg.norm(high - low))
    views = [(360.0 * i / _AZIMUTHS + 25.0, -18.0, 0.0) for i in range(_AZIMUTHS)]
    views += [(25.0, -75.0, 0.0), (25.0, 30.0, 0.0)]
    if plan.grab.max_jaw:
        views += [(25.0, -18.0, 1.0), (115.0, -18.0, 1.0)]
    tiles, view = [], mujoco.MjrRect(0, 0, _TILE, _TILE)
    world.model.vis.global_.offwidth = world.model.vis.global_.offheight = _TILE
    option = mujoco.MjvOption()
    option.geomgroup[:] = 0
    option.geomgroup[[GRAB, ROPE]] = 1
    with gl.offscreen(world.model, _TILE, _TILE) as context:
        for azimuth, elevation, opening in views:
            state = GrabState(0.0, 0.0, _ROPE_M, 0.0, opening * plan.grab.max_jaw, 0.0)
            world.pose(data, Moment(0, state, Tilt(0.0, 0.0, 0.0), 0.0))
            camera = mujoco.MjvCamera()
            camera.lookat[:] = (0.0, 0.0, -_ROPE_M)
            camera.distance, camera.azimuth, camera.elevation = 1.45 * reach, azimuth, elevation
            drawn = mujoco.MjvScene(world.model, maxgeom=world.model.ngeom + 16)
            mujoco.mjv_updateScene(world.model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, drawn)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context.context)
            mujoco.mjr_render(view, drawn, context.context)
            picture, depth = np.empty((_TILE, _TILE, 3), np.uint8), np.empty((_TILE, _TILE), np.float32)
            mujoco.mjr_readPixels(picture, depth, view, context.context)
            picture[(depth <= 0.0) | (depth >= 1.0)] = 235  # nothing was drawn there, whichever end is far
            framed = np.ascontiguousarray(picture[::-1])
            tiles.append(cv2.rectangle(framed, (0, 0), (_TILE - 1, _TILE - 1), (200, 200, 200), 1))
    while len(tiles) % 4:
        tiles.append(np.full_like(tiles[0], 235))
    return np.concatenate([np.concatenate(tiles[i : i + 4], axis=1) for i in range(0, len(tiles), 4)])

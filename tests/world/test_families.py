"""Laws of the parametric grabs: closed steel, volume, linkage, clearance, mass, ropes, cargo."""

import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from itertools import pairwise

import msgspec
import numpy as np
import pytest
import trimesh
from trimesh.transformations import translation_matrix

from simgrab.errors import ScenarioError
from simgrab.model import scenes
from simgrab.model.scenario import Clutter
from simgrab.model.scenario.grab import Assembled, Clamshell, FourRope, Grab, OrangePeel, Scissors
from simgrab.world.scenery.clearance import winding
from simgrab.world.scenery.grabs import FAMILIES, design_of
from simgrab.world.scenery.grabs.design import CARGO_LEVELS, Design
from simgrab.world.scenery.grabs.drawn import any_of
from simgrab.world.scenery.grabs.four_rope import SHAPE
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.parked import parked_grabs
from simgrab.world.scenery.plan import CLEARANCE_M, draw_up
from simgrab.world.trajectory import iid
from simgrab.world.trajectory.trajectory import Trajectory

KINDS = ("clamshell", "orange-peel", "scissors")
SMALL, LARGE = {"volume_m3": 3.0}, {"volume_m3": 20.0}
EXTREMES: tuple[Grab, ...] = (
    Clamshell(**SMALL, width=0.75, length=1.35, height=0.75, teeth=12, plate_work=1.0),
    Clamshell(**LARGE, width=1.35, length=0.75, height=1.35, top="closed", ropes=1, head="round", plate_work=0.0),
    Clamshell(**LARGE, width=0.75, length=0.75, height=1.35, drive="hydraulic", ropes=2, profile="angular"),
    OrangePeel(**SMALL, width=0.75, length=0.75, height=1.35, tines=3),
    OrangePeel(**LARGE, width=1.35, length=1.35, height=0.75, tines=8, shells="half", ropes=2),
    OrangePeel(**LARGE, height=1.35, tines=4, shells="open", drive="hydraulic", ropes=1),
    Scissors(**SMALL, width=1.35, length=0.75, height=0.75, ropes=2, top="closed"),
    Scissors(**LARGE, width=0.75, length=1.35, height=1.35, teeth=12, plate_work=1.0),
    Clamshell(**SMALL, width=0.75, length=0.75, height=1.35, head="round"),  # its sheaves' openings cross the deck
    SHAPE,
)
DRAWN = tuple(any_of(kind, np.random.default_rng(seed), (3.0, 20.0)) for kind in KINDS for seed in range(2))
GRABS = EXTREMES + DRAWN
ASSEMBLED = tuple(Assembled(shape=i / 9, volume_m3=3 + 2 * i, ropes=(1, 2, 4)[i % 3]) for i in range(9))
RANDOM = ASSEMBLED if find_spec("simgrab.training") else ()  # the room that draws them


def of_each(grabs: tuple[Grab, ...]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("grab", grabs, ids=lambda g: f"{type(g).__name__}-{grabs.index(g)}")


each, each_and_random = of_each(GRABS), of_each(GRABS + RANDOM)


def jaws(design: Design) -> np.ndarray:
    return np.linspace(0.0, design.max_jaw, 9)


@cache
def moves(grab: Grab) -> dict[str, list[np.ndarray]]:
    """How each body has moved since the grab was closed, (4, 4), for every opening, in the grab frame."""
    design = design_of(grab)
    closed = design.frames(0.0)
    found = [design.frames(float(jaw)) for jaw in jaws(design)]
    return {b.name: [frames[b.name] @ np.linalg.inv(closed[b.name]) for frames in found] for b in design.bodies}


def steel(grab: Grab, *stems: str, parts: tuple[str, ...] = ()) -> trimesh.Trimesh:
    """Steel of bodies in the closed grab, by the beginnings of their names, and of some of their parts alone."""
    design = design_of(grab)
    frames = design.frames(0.0)
    bodies = [body for body in design.bodies if not stems or body.name.startswith(stems)]
    chosen = [(frames[b.name], part) for b in bodies for part in b.parts if not parts or part.name in parts]
    return trimesh.util.concatenate([part.mesh.copy().apply_transform(frame) for frame, part in chosen])


@each_and_random
def test_all_steel_is_closed_and_faces_outwards(grab: Grab) -> None:
    design = design_of(grab)
    for body in design.bodies:
        for part in body.parts:
            assert part.mesh.is_watertight, (body.name, part.name)
            assert part.mesh.is_winding_consistent, (body.name, part.name)
            assert np.isfinite(part.mesh.vertices).all()
            assert all(piece.volume > 0 for piece in part.mesh.split()), (body.name, part.name)
    assert sum(len(part.mesh.faces) for body in design.bodies for part in body.parts) < 45_000


@each_and_random
def test_the_centre_is_on_the_ropes_axis_at_half_the_height(grab: Grab) -> None:
    design = design_of(grab)
    low, high = steel(grab).bounds
    assert low[2] + high[2] == pytest.approx(0.0, abs=1e-9)
    assert len(design.terminations) == grab.ropes
    np.testing.assert_allclose(design.terminations[:, :2].mean(axis=0), 0.0, atol=1e-12)
    assert np.ptp(design.terminations[:, 2]) == 0
    assert 0.5 * high[2] < design.terminations[0, 2] < high[2] + 0.3


def room(mesh: trimesh.Trimesh, z: float) -> float:
    """Area that steel encloses round the axis at a height, by distances to it in all directions."""
    segments = trimesh.intersections.mesh_plane(mesh, (0.0, 0.0, 1.0), (0.0, 0.0, z))[:, :, :2]
    angles = (np.arange(360) + 0.31) * 2 * np.pi / 360
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    with np.errstate(all="ignore"):
        across = ray[:, None, 0] * along[None, :, 1] - ray[:, None, 1] * along[None, :, 0]
        distance = (a[:, 0] * along[:, 1] - a[:, 1] * along[:, 0])[None] / across
        share = (a[None, :, 0] * ray[:, None, 1] - a[None, :, 1] * ray[:, None, 0]) / across
        hit = (share >= 0) & (share <= 1) & (distance > 0)
    nearest = np.where(hit, distance, np.inf).min(axis=1)
    seen = np.isfinite(nearest)  # not through the gap between two tines
    return float(np.interp(angles, angles[seen], nearest[seen], period=2 * np.pi) ** 2 @ np.full(360, np.pi / 360))


@pytest.mark.parametrize("height", [0.75, 1.0, 1.35])
@pytest.mark.parametrize(
    ("grab", "stem", "parts"),
    [
        (Clamshell(volume_m3=4.0), "shell", ("back", "sides")),
        (Clamshell(volume_m3=15.0, profile="angular", width=1.2), "shell", ("back", "sides")),
        (Scissors(volume_m3=8.0, length=0.8), "shell", ("back", "sides")),
        (OrangePeel(volume_m3=4.0, tines=8), "tine", ("back",)),
        (OrangePeel(volume_m3=15.0, tines=5, width=1.2), "tine", ("back",)),
    ],
)
def test_the_closed_grab_holds_its_volume(grab: Grab, stem: str, parts: tuple[str, ...], height: float) -> None:
    grab = msgspec.structs.replace(grab, height=height)
    shells = steel(grab, stem, parts=parts)
    low, high = shells.bounds[:, 2]
    rim = steel(grab, stem, parts=("back",)).bounds[1, 2]
    heights, step = np.linspace(low, rim, 60, retstep=True)
    held = step * sum(room(shells, float(z)) for z in heights[:-1] + step / 2)
    assert held == pytest.approx(grab.volume_m3, rel=0.02)
    assert high >= rim


LINKS = (*((link, "shell") for link in ("arms", "link", "reeving", "piston")), ("rod", "tine"), ("piston", "tine"))


@each
def test_links_stay_on_their_pins(grab: Grab) -> None:
    found = 0
    for link, jaw in LINKS:
        names = [name for name in moves(grab) if name.startswith(f"{link}_")]
        for name in names:
            partner = name.replace(link, jaw)
            if partner not in moves(grab):
                continue
            apart = [a - b for a, b in zip(moves(grab)[name], moves(grab)[partner], strict=True)]
            matrix, offset = (np.concatenate([m[:3, s] for m in apart]) for s in (slice(0, 3), 3))
            pin = np.linalg.lstsq(matrix, -offset, rcond=1e-9)[0]
            np.testing.assert_allclose(matrix @ pin, -offset, atol=1e-9)
            assert np.linalg.norm(matrix) > 0.1, "they do not move apart"
            pins = steel(grab, name).vertices
            plane = np.linalg.svd(matrix)[2][:2]  # the pin lies along the axis somewhere
            assert np.linalg.norm((pins - pin) @ plane.T, axis=1).min() < 0.2
            found += 1
    assert found >= 2


@each
def test_lips_meet_in_the_closed_grab_and_move_outwards(grab: Grab) -> None:
    design = design_of(grab)
    assert all(q == pytest.approx(0.0, abs=1e-12) for q in design.positions(0.0).values())
    reach = []
    for jaw in jaws(design):
        frames = design.frames(float(jaw))
        lips = np.concatenate([trimesh.transform_points(p, frames[body]) for body, p in design.lips.items()])
        away = np.abs(lips[:, 0]) if not isinstance(grab, OrangePeel) else np.linalg.norm(lips[:, :2], axis=1)
        assert np.ptp(away) < 1e-9
        reach.append(away[0])
    assert reach[0] < 0.03
    assert np.all(np.diff(reach) > 0)
    assert reach[-1] > 0.25 * np.ptp(steel(grab).vertices[:, 0])
    for body, points in design.lips.items():
        own = next(b for b in design.bodies if b.name == body).steel
        assert all(np.linalg.norm(own.vertices - p, axis=1).min() < 0.15 for p in points)


@each
def test_jaws_stay_in_their_own_sectors(grab: Grab) -> None:
    names = [b.name for b in design_of(grab).bodies if b.name.startswith(("tine", "shell"))]
    jaw_parts = {part.name for b in design_of(grab).bodies if b.name in names for part in b.parts}
    jaw_parts -= {"levers", "bosses", "block_pin", "block", "stiffeners"}  # these cross
    for name in names:
        closed = steel(grab, name, parts=tuple(jaw_parts)).vertices
        middle = closed.mean(axis=0)
        azimuth = 0.0 if name == "shell_outer" else np.pi if name == "shell_inner" else np.arctan2(middle[1], middle[0])
        across = np.array([-np.sin(azimuth), np.cos(azimuth)])
        along = np.array([np.cos(azimuth), np.sin(azimuth)])
        half = np.pi / len(names)
        for move in moves(grab)[name]:
            p = trimesh.transform_points(closed, move)[:, :2]
            r, y = p @ along, np.abs(p @ across)
            if len(names) == 2:
                assert r.min() > -0.2  # ears reach beside the other shell's
            else:
                beyond = y * np.cos(half) - np.maximum(r, 0.0) * np.sin(half)  # distance past the sector's edge
                assert beyond.max() < 0.03, name


@each
def test_what_slides_stays_below_the_head(grab: Grab) -> None:
    below = ("pivot", "shell", "reeving") if isinstance(grab, Scissors) else ("beam",)
    head = steel(grab, "head", parts=("head_body", "deck"))
    for name in (name for name in moves(grab) if name.startswith(below)):
        body = steel(grab, name).vertices
        for move in moves(grab)[name]:
            assert trimesh.transform_points(body, move)[:, 2].max() < head.bounds[0, 2], name


@each
def test_mass_follows_the_steel_and_the_load(grab: Grab) -> None:
    design = design_of(grab)
    for body in design.bodies:
        assert body.mass_kg == pytest.approx(7850 * 0.95 * sum(part.mesh.volume for part in body.parts))
    empty = design.mass_of(0.0, 0.0)
    assert empty.mass == pytest.approx(design.mass_kg, rel=1e-9)
    assert 500 < empty.mass / grab.volume_m3 < 4000
    if design.holds_cargo:
        full = design.mass_of(0.0, 1.0)
        assert full.mass - empty.mass == pytest.approx(850 * grab.volume_m3, rel=1e-9)
        assert full.centre_z < empty.centre_z


@of_each((*GRABS, FourRope()))
def test_mass_properties_are_those_of_the_meshes(grab: Grab) -> None:
    design = design_of(grab)
    for jaw in (0.0, 0.3 * design.max_jaw, design.max_jaw):
        placed, found = [], design.mass_of(jaw, 0.0)
        for body in design.bodies:
            placed.append(body.steel.copy().apply_transform(design.frames(jaw)[body.name]))
            placed[-1].density = body.mass_kg / placed[-1].volume
        centre = sum(m.mass * m.center_mass for m in placed) / design.mass_kg
        inertia = sum(m.moment_inertia_frame(translation_matrix(centre)) for m in placed)
        assert found.centre_z == pytest.approx(centre[2], abs=2e-3 if jaw == 0 else 0.01)
        assert found.inertia == pytest.approx(tuple(np.diag(inertia)), rel=0.01)


@each
def test_the_closing_rope_pays_out_what_the_falls_take(grab: Grab) -> None:
    design = design_of(grab)
    paid = [design.closing_rope_m(float(jaw)) for jaw in jaws(design)]
    if not design.closing:
        assert paid == [0.0] * len(paid)
        return
    assert paid[0] == 0.0
    assert np.all(np.diff(paid) > 0)
    if isinstance(grab, Scissors):  # between the levers' upper ends
        frames = [design.frames(float(jaw)) for jaw in jaws(design)]
        blocks = [[f[f"reeving_{side}"][0, 3] for side in ("outer", "inner")] for f in frames]
        travel = np.ptp(blocks, axis=1) - np.ptp(blocks[0])
        ends = [trimesh.transform_points(design.leads[:, 1], f["shell_outer"]) for f in frames]
        leads = np.linalg.norm(np.array(ends) - design.leads[:, 0], axis=2)
        assert leads.shape[1] == len(design.closing)
        assert np.all(leads > 0.3)
        paid = paid - (leads - leads[0]).mean(axis=1)
    else:
        travel = [abs(move[2, 3]) for move in moves(grab)[design.falls_to]]
    np.testing.assert_allclose(paid, np.array(travel) * len(design.falls) / len(design.closing), rtol=0.02, atol=1e-3)


@each
def test_cargo_lies_inside_and_rises_with_the_fill(grab: Grab) -> None:
    design = design_of(grab)
    heaps = design.heaps("coal", np.random.default_rng(3))
    if not design.holds_cargo:
        assert not heaps
        return
    assert len(heaps) == len(CARGO_LEVELS)
    shells = steel(grab, "tine", "shell", parts=("back", "sides"))
    low, high = shells.bounds
    rng = np.random.default_rng(0)
    for heap in heaps:
        assert heap.mesh.is_watertight
        assert heap.mesh.volume > 0
        points = rng.permutation(heap.mesh.vertices)[:60]
        assert np.all(points > low)
        assert np.all(points[:, :2] < high[:2])
        assert all(abs(winding(shells, point)) < 0.5 for point in points)
    volumes = [heap.mesh.volume for heap in heaps]
    assert all(a < b for a, b in pairwise(volumes))
    assert 0.6 * grab.volume_m3 < volumes[-1] < 1.25 * grab.volume_m3


def test_a_family_is_imported_when_it_is_drawn_and_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = "; ".join((
        "import sys", "from simgrab import scenes", "from simgrab.world.scenery.plan import draw_up",
        "draw_up(scenes.load('quay-day'))",
        "print([m for m in sys.modules if m.endswith(('.assembled', 'scissors', 'random_place'))])",
    ))  # fmt: skip
    done = subprocess.run([sys.executable, "-c", drawn], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
    monkeypatch.setitem(FAMILIES, "assembled", ("simgrab.nowhere", "assembled"))
    with pytest.raises(ScenarioError, match=r"'assembled' is not installed: No module named .simgrab.nowhere"):
        design_of(Assembled(shape=0.123))


def test_designs_that_differ_in_appearance_alone_are_one() -> None:
    assert design_of(Clamshell(wear=0.1, cargo="ore")) is design_of(Clamshell(wear=0.9, paint_rgb=(0, 0, 0)))


@pytest.mark.parametrize("grab", [g for g in GRABS if isinstance(g, Scissors)])
def test_levers_pass_beside_each_other(grab: Scissors) -> None:
    spans = sorted((piece.bounds[:, 1] for piece in steel(grab, parts=("levers",)).split()), key=lambda span: span[0])
    assert len(spans) == 4
    assert all(a[1] < b[0] for a, b in pairwise(spans))


@pytest.mark.parametrize("model", KINDS)
def test_clamped_draws_are_the_nearest_possible(model: str) -> None:
    changes = {
        "grab": {"model": model, "volume_m3": 12.0}, "frames": 12, "seed": 4,
        "swing.jaw_deg": {"dist": "choice", "values": [0.0, 89.0], "weights": [1, 1]},
        "swing.load": {"dist": "choice", "values": [1.0], "weights": [1]},
        "swing.rope_length_m": {"dist": "uniform", "low": 8.0, "high": 34.0},
    }  # fmt: skip
    free = scenes.load("quay-day", changes)
    clamped = scenes.load("quay-day", changes | {"swing.clamp": True})
    shut = scenes.load("quay-day", changes | {"swing.jaw_deg": {"dist": "choice", "values": [0.0], "weights": [1]}})
    plan = draw_up(clamped)
    asked, given = ([iid.draw(scene, frame) for frame in range(12)] for scene in (shut, clamped))
    moments = [Trajectory(clamped, plan=plan).at(frame) for frame in range(12)]
    with pytest.raises(ScenarioError, match=r'swing\.clamp = \["jaw_deg"\]'):
        [iid.draw(free, frame) for frame in range(12)]
    lifted = 0
    for before, alone, moment in zip(asked, given, moments, strict=True):
        assert alone.grab.jaw in (0.0, plan.grab.max_jaw)
        assert (alone.grab.jaw == 0.0) == (alone.grab.load == 1.0)  # open jaws hold nothing
        assert alone.grab.alpha == before.grab.alpha
        assert alone.grab.rope_length == before.grab.rope_length
        assert moment.grab.rope_length <= alone.grab.rope_length
        points = trimesh.transform_points(plan.grab_points(moment.grab), moment.grab.jib_from_grab)
        assert plan.ground.gap(points) >= CLEARANCE_M
        shorter = moment.grab.rope_length < alone.grab.rope_length
        opened = ("jaw_deg",) if alone.grab.jaw else ()
        assert moment.clamped == opened + (("rope_length_m",) if shorter else ())
        lifted += shorter
    assert 0 < lifted < 12
    jaws = scenes.load("quay-day", changes | {"swing.clamp": ["jaw_deg"]})
    alone = [Trajectory(jaws, plan=plan).at(frame) for frame in range(12)]
    assert [moment.grab.rope_length for moment in alone] == [moment.grab.rope_length for moment in asked]


@pytest.mark.parametrize("kind", [*KINDS, *("assembled" for _ in RANDOM[:1])])
def test_grabs_of_a_kind_stand_about_whole_and_on_the_ground(kind: str) -> None:
    place = [Part("ground", trimesh.creation.box((200.0, 200.0, 2.0)), Material("ground"))]
    clutter = Clutter(other_grabs=4, kinds=(kind,))
    for seed in range(3):
        parts = parked_grabs(clutter, place, head_height=0.0, rng=np.random.default_rng(seed))
        numbers = {part.name.partition("/")[0] for part in parts}
        assert len(numbers) == 4
        for number in numbers:
            own = np.concatenate([p.mesh.vertices for p in parts if p.name.startswith(f"{number}/")])
            assert own[:, 2].min() == pytest.approx(1.0, abs=1e-9)
            assert 1.5 < np.ptp(own[:, 2]) < 8.0

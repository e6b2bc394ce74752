"""Places: solid, finite, on the ground, wide enough, and the same from the same stream."""

from functools import cache

import numpy as np
import pytest
import trimesh
from conftest import slow_but
from numpy.typing import NDArray

from simgrab.model.rng import stream
from simgrab.model.scenario import Hold, Plain, Quay, Water
from simgrab.world.scenery.clearance import HeightMap
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.places import build

HEIGHT = 28.0
OPTIONS: dict[str, Quay | Hold | Water | Plain] = {
    "quay, coal, hopper": Quay(),
    "quay, ore, truck, no pile": Quay(cargo="ore", receiver="truck", pile_height_m=0.0, wear=1.0),
    "quay, grain, high pile": Quay(cargo="grain", receiver="none", pile_height_m=5.0, wear=0.0),
    "hold, coal, full": Hold(fill=1.0, depth_m=12.0),
    "hold, ore, empty": Hold(cargo="ore", fill=0.0, depth_m=18.0, wear=1.0),
    "plain": Plain(),
    "water, rough": Water(freeboard_m=8.0, quay_height_m=6.0, chop=1.0),
}
FAST = ("quay, grain, high pile", "hold, coal, full", "plain", "water, rough")
GROUND = ("apron", "water", "deck 0", "deck 1", "deck 2", "deck 3", "deck 4", "hull", "tank top", "quay wall", "yard")


@cache
def place(name: str) -> list[Part]:
    return build(OPTIONS[name], head_height=HEIGHT, rng=stream(0, 0, "place"))


def bodies(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high corners of the boxes around the connected solids of a mesh, each (N, 3)."""
    label = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    corners, key = mesh.triangles.reshape(-1, 3), label.repeat(3)
    low, high = (np.full((label.max() + 1, 3), v) for v in (np.inf, -np.inf))
    np.minimum.at(low, key, corners)
    np.maximum.at(high, key, corners)
    return low, high


@pytest.mark.parametrize("name", slow_but(OPTIONS, *FAST))
def test_parts_are_closed_finite_named_once_and_within_their_budget(name: str) -> None:
    parts = place(name)
    materials = {p.material.name: p.material for p in parts}
    assert len({p.name for p in parts}) == len(parts)
    for part in parts:
        mesh, uv = part.mesh, np.zeros((len(part.mesh.vertices), 2)) if part.uv is None else part.uv
        assert uv.shape == (len(mesh.vertices), 2), part.name
        assert np.isfinite([*mesh.vertices.ravel(), *uv.ravel()]).all(), part.name
        assert (mesh.is_watertight, mesh.is_winding_consistent, mesh.volume > 0) == (True, True, True), part.name
    assert sum(len(p.mesh.faces) for p in parts) < 120_000
    assert len(materials) <= 60
    assert sum(m.picture.nbytes for m in materials.values() if m.picture is not None) < 115e6


@pytest.mark.parametrize("name", slow_but([n for n in OPTIONS if n != "plain"], *FAST))  # which has no corner near
def test_the_height_map_is_as_high_as_every_corner_near(name: str) -> None:
    parts = place(name)
    ground = HeightMap.of((p.mesh for p in parts), 16.0)
    corners = np.concatenate([p.mesh.vertices for p in parts])
    near = corners[(np.abs(corners[:, :2]) < 14.0).all(axis=1)]
    assert ground.gap(near) <= 0.0
    # A corner may lie on the border of its cell; around it, something is as high.
    raised = near + [0.0, 0.0, 0.001]
    shifts = [(dx, dy, 0.0) for dx in (-0.1, 0.0, 0.1) for dy in (-0.1, 0.0, 0.1)]
    assert all(min(ground.gap(p[None] + s) for s in shifts) <= 0.001 + 1e-9 for p in raised[:: len(raised) // 300])
    assert np.isfinite(ground.top).mean() > 0.99
    above = np.array([[0.0, 0.0, -8.0]])  # a grab on a short rope hangs clear
    assert ground.gap(above) > 0.0
    assert ground.gap(np.array([[500.0, 0.0, -90.0]])) == np.inf


@pytest.mark.parametrize("name", slow_but(OPTIONS, *FAST))
def test_the_world_has_no_edge_within_70_m(name: str) -> None:
    corners = np.concatenate([p.mesh.triangles[:, :, :2] for p in place(name)])
    low, high = corners.min(axis=1), corners.max(axis=1)
    broad = (high - low).min(axis=1) > 0.05
    corners, low, high = corners[broad], low[broad], high[broad]
    radius, angle = np.meshgrid([0.0, 11.0, 23.0, 36.0, 49.0, 60.0, 70.0], np.arange(0, 2 * np.pi, 0.42))
    for spot in np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 2) + 0.0137:
        a, b, c = (corners[((low <= spot) & (spot <= high)).all(axis=1)][:, i] - spot for i in range(3))
        turn = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((a, b), (b, c), (c, a))])
        assert ((turn >= 0).all(axis=0) | (turn <= 0).all(axis=0)).any(), spot


@pytest.mark.parametrize("name", slow_but(OPTIONS, *FAST))
def test_nothing_floats(name: str) -> None:
    """Every solid is joined to the ground by a chain of solids whose boxes touch within a centimetre."""
    parts = place(name)
    boxes = [bodies(p.mesh) for p in parts]
    low, high = (np.concatenate([b[i] for b in boxes]) for i in (0, 1))
    owner = np.repeat(np.arange(len(parts)), [len(b[0]) for b in boxes])
    held = np.array([p.name.startswith(GROUND) for p in parts])[owner]
    new = held.copy()
    while new.any():
        touched = np.zeros_like(held)
        for k in np.flatnonzero(new):
            touched |= ((low <= high[k] + 0.01) & (high >= low[k] - 0.01)).all(axis=1)
        new = touched & ~held
        held |= new
    assert not [(parts[owner[k]].name, *low[k].round(2), *high[k].round(2)) for k in np.flatnonzero(~held)[:6]]


def test_the_same_stream_gives_the_same_place_and_another_seed_another() -> None:
    option = OPTIONS["water, rough"]
    first = place("water, rough")
    again = build(option, head_height=HEIGHT, rng=stream(0, 0, "place"))
    other = build(option, head_height=HEIGHT, rng=stream(1, 0, "place"))
    assert [p.name for p in first] == [p.name for p in again]
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices)
    pictures = [[p.material.picture for p in parts] for parts in (first, reversed(again))]  # painted in another order
    for one, two in zip(pictures[0], reversed(pictures[1]), strict=True):
        assert one is None or (np.array_equal(one, two) and one.any())
    lines = [next(p for p in parts if p.name == "mooring lines").mesh.vertices for parts in (first, other)]
    assert not np.array_equal(*lines)


def test_the_head_height_moves_the_place_and_changes_nothing_else() -> None:
    high = build(OPTIONS["water, rough"], head_height=HEIGHT + 7.0, rng=stream(0, 0, "place"))
    for a, b in zip(place("water, rough"), high, strict=True):
        np.testing.assert_allclose(a.mesh.vertices - [0, 0, 7.0], b.mesh.vertices, atol=1e-9)

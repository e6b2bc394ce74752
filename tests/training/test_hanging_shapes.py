"""Shapes that hang from the ropes in training."""

import pickle

import numpy as np
import pytest
import trimesh

from scripts import hanging_shapes
from scripts.drawn_shapes import load, plain
from scripts.hung_shape import hang
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Mesh, vary


@pytest.mark.parametrize("draw", [plain, load])
def test_ropes_end_on_the_upper_side_of_drawn_shapes(draw):
    hung = [hang(draw(rng), rng) for i in range(12) if (rng := stream(3, i, "shapes"))]
    assert sum(one is not None for one in hung) > 8
    for meshes, ends, mass in (one for one in hung if one is not None):
        every = trimesh.util.concatenate([trimesh.Trimesh(mesh.vertices, mesh.faces) for mesh in meshes])
        assert 1.5 <= every.extents.max() <= 6.0
        assert every.bounds[0, 2] == pytest.approx(0, abs=1e-6)
        assert len(every.faces) <= 20_000
        assert 100 <= mass <= 40_000
        assert len(ends) in (1, 2, 4)
        assert (ends[:, 2] > every.extents[2] / 2).all()
        away = trimesh.proximity.closest_point_naive(every, ends)[1]
        assert np.abs(away).max() < 1e-3


def test_scenes_show_a_collection_hanging_and_standing_about(tmp_path, monkeypatch):
    monkeypatch.setattr(hanging_shapes, "COLLECTIONS", {})
    monkeypatch.setattr(hanging_shapes, "OWN", 6)
    hanging_shapes.prepare(tmp_path)
    written = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.*")}
    hanging_shapes.prepare(tmp_path)
    assert written == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.*")}
    scenario = scenes.load(tmp_path / "plain-places.toml")
    assert len({model.name for model in scenario.models}) == len(list((tmp_path / "models" / "plain").iterdir()))
    drawn = [vary.variant(scenario, frame).scenario for frame in range(20)]
    assert all(isinstance(one.grab, Mesh) for one in drawn)
    parked = next(one for one in drawn if isinstance(one.clutter.kinds[0], Mesh))
    assert {kind.sha256 for kind in parked.clutter.kinds} <= {model.sha256 for model in parked.models}
    assert pickle.loads(pickle.dumps(parked)) == parked

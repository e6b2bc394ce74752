"""What looks wrong with the jaws and keypoints of a user's own grab."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from simgrab.io.parse import shown
from simgrab.model.geometry import Array
from simgrab.model.scenario import Mesh
from simgrab.world.scenery.grabs.design import Body, Design

IN_AIR_M = 0.15  # a rope's end or a keypoint so far from any steel is in the air
_HINGE = 0.25  # of a jaw's longest side: a hinge so far from it turns something else
_VERTICAL = 0.9  # of an axis' length along z
_MOUTH = 0.1  # of the grab's width: closed jaws do not stand so far apart
_LIPS = 0.6  # of a jaw's reach from its hinge, beyond which it is its mouth
_SAMPLES = 4_000
_UNITS = "in metres from the file's origin, z up"


def distance(steel: trimesh.Trimesh, point: Array) -> float:
    """Return how far a point, shape (3,), lies from a mesh's surface."""
    nearest = trimesh.triangles.closest_point(steel.triangles, np.tile(point, (len(steel.faces), 1)))
    return float(np.linalg.norm(nearest - point, axis=1).min())


def doubts(keys: Mesh, made: Design, width_m: float) -> list[str]:
    """Return possible mistakes in ``jaws`` and ``lips_m``, a sentence each, of keys and the design made of them.

    ``width_m`` is the longest horizontal side of the closed grab.
    """
    bodies = {body.name: body for body in made.bodies}
    nodes = {"head": "the head"} | {f"jaw_{i}": shown(jaw.node) for i, jaw in enumerate(keys.jaws)}
    ends = set(bodies) - {body.parent for body in made.bodies}
    found, mouths = [], {}
    for i, jaw in enumerate(keys.jaws):
        body, node = bodies[f"jaw_{i}"], nodes[f"jaw_{i}"]
        if not jaw.open_deg:
            continue
        points = trimesh.sample.sample_surface(body.steel, _SAMPLES, seed=0)[0]
        radii = np.linalg.norm(np.cross(points, body.axis), axis=1)
        if radii.min() > _HINGE * np.ptp(points, axis=0).max():
            found.append(f"The hinge of {node} lies {radii.min():.2f} m from its own steel: check hinge_m, {_UNITS}.")
        if abs(body.axis[2]) > _VERTICAL:
            found.append(f"The axis of {node}, {jaw.axis}, is vertical: axes are in coordinates with z up, whatever "
                         "those of the file. Give one that lies level, such as [0, 1, 0].")  # fmt: skip
        elif body.parent == made.bodies[0].name:
            mouth = points[(radii > _LIPS * radii.max()) & (points[:, 2] < 0)]
            if body.name in ends and len(mouth):
                mouths[body.name] = mouth
            if _outwards(made, body) < 0:
                found.append(f"The lower end of {node} moves inwards as it opens: check the sign of open_deg.")
    found += _doubts_of_mouths(made, mouths, _MOUTH * width_m)
    for name, lips in made.lips.items():
        away = max(distance(bodies[name].steel, lip) for lip in lips)
        if away > IN_AIR_M:
            found.append(f"A point of lips_m of {nodes[name]} lies {away:.2f} m from its steel: check lips_m, "
                         f"{_UNITS}.")  # fmt: skip
    return found


def _outwards(made: Design, body: Body) -> float:
    """Return how far a jaw's lower end moves from the ropes' axis, metres, as it begins to open."""
    steel = np.asarray(body.steel.vertices)
    closed, ajar = (made.frames(share * made.max_jaw)[body.name] for share in (0.0, 0.05))
    height = trimesh.transform_points(steel, closed)[:, 2]
    lowest = steel[height <= np.quantile(height, 0.2)]
    before, after = (trimesh.transform_points(lowest, frame)[:, :2] for frame in (closed, ajar))
    return float(np.linalg.norm(after, axis=1).mean() - np.linalg.norm(before, axis=1).mean())


def _doubts_of_mouths(made: Design, mouths: Mapping[str, Array], apart_m: float) -> list[str]:
    """Doubt jaws that stand apart when closed, and would meet if they turned the other way.

    ``mouths`` has points of each jaw, shape (n, 3), in its own frame.
    """
    closed, gaps = made.frames(0.0), []
    for share in np.linspace(0.0, made.max_jaw, 5).tolist():
        opened = made.frames(share)
        shut = {name: closed[name] @ np.linalg.inv(opened[name]) @ closed[name] for name in mouths}
        gaps.append(_gap([trimesh.transform_points(points, shut[name]) for name, points in mouths.items()]))
    if not gaps[0] > apart_m > min(gaps):
        return []
    return [f"At jaw_deg 0 the jaws are {gaps[0]:.1f} m apart, and would meet if they turned the other way: does the "
            "file show the grab open? Export it closed, or jaw_deg is wrong in every label."]  # fmt: skip


def _gap(mouths: Sequence[Array]) -> float:
    """Return the least distance between mouths on opposite sides of the ropes' axis, metres; 0 for none."""
    facing = [(one, other) for one, other in itertools.combinations(mouths, 2)
              if one[:, :2].mean(axis=0) @ other[:, :2].mean(axis=0) < 0]  # fmt: skip
    return min((float(cKDTree(one).query(other)[0].min()) for one, other in facing), default=0.0)

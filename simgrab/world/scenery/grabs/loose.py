"""Steel of a model that touches no other, such as a forgotten dimension block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from simgrab.io.parse import shown
from simgrab.model.geometry import Array

_APART, _LEAST_APART_M = 0.1, 0.25  # of the longest side, and at least
_CELLS = 8  # of a grid, across that distance
_ROUNDS = 4  # those that lie very far first
_MOST_SAID = 6  # in a round
_SAMPLES = 100_000


def surface_points(mesh: trimesh.Trimesh, count: int = _SAMPLES) -> Array:
    """Return a mesh's vertices and points all over its faces, shape (n, 3)."""
    return np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, count, seed=0)[0]])


def loose(named: Sequence[tuple[str, Array]], origin: Array) -> tuple[list[str], Array]:
    """Find steel that stands apart from the largest body, where the distance is large for the body's size.

    Parameters
    ----------
    named : sequence of (str, ndarray of shape (n, 3, 3))
        Names of nodes and their triangles, metres.
    origin : ndarray, shape (3,)
        Of the triangles, from the file's origin, metres.

    Returns
    -------
    said : list of str
        What is loose, without a full stop.
    sides : ndarray, shape (3,)
        Of the rest, metres.
    """
    triangles = np.concatenate([of_node for _, of_node in named])
    node = np.repeat(np.arange(len(named)), [len(of_node) for _, of_node in named])
    kept, said = np.arange(len(triangles)), []
    for _ in range(_ROUNDS):
        body = _body(triangles[kept])
        sizes = np.bincount(body, weights=trimesh.triangles.area(triangles[kept]))
        largest = np.argsort(-sizes, kind="stable")[: _MOST_SAID + 1]
        if len(largest) == 1:
            break
        rest = cKDTree(surface_points(_mesh(triangles[kept[body == largest[0]]])))
        for one in largest[1:]:
            own = kept[body == one]
            names = []
            for i in np.unique(node[own])[:3]:
                whole = np.isin(np.flatnonzero(node == i), own).all()
                names.append(f"{'' if whole else 'a part of '}{shown(named[i][0])}")
            points = triangles[own].reshape(-1, 3)
            where = ", ".join(f"{x:.2f}" for x in origin + (points.min(axis=0) + points.max(axis=0)) / 2)
            away = rest.query(surface_points(_mesh(triangles[own]), 1000))[0].min()
            said.append(f"{', '.join(names)} at ({where}) m touches nothing: the grab is {away:.2f} m away")
        kept = kept[body == largest[0]]
    return said, np.ptp(triangles[kept], axis=(0, 1))


def _mesh(triangles: Array) -> trimesh.Trimesh:
    return trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)


def _body(triangles: Array) -> NDArray[np.int32]:
    """Return the number of the body that each triangle belongs to: all steel within reach of each other."""
    points = surface_points(_mesh(triangles))
    cell_m = max(_APART * np.ptp(points, axis=0).max(), _LEAST_APART_M) / _CELLS
    cells = tuple(((points - points.min(axis=0)) / cell_m).astype(int).T)
    empty = np.ones(np.max(cells, axis=1) + 1, bool)
    empty[cells] = False
    numbers, count = ndimage.label(ndimage.distance_transform_edt(empty) <= _CELLS / 2, np.ones((3, 3, 3)))
    first, *others = numbers[cells][: 3 * len(triangles)].reshape(-1, 3).T - 1
    # A triangle is whole, however few points lie on it.
    links = coo_array(
        (np.ones(2 * len(first), bool), (np.tile(first, 2), np.concatenate(others))), shape=(count, count)
    )
    return np.asarray(connected_components(links, directed=False)[1][first])

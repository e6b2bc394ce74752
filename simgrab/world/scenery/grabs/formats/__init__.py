"""Files of 3-D models, each read by its format's standard into the same shapes."""

from simgrab.io.models import ModelFile
from simgrab.io.parse import Refuse
from simgrab.world.scenery.grabs.formats import gltf, obj, ply, stl
from simgrab.world.scenery.grabs.formats.contents import Contents

_READERS = {"glb": gltf.read, "gltf": gltf.read, "obj": obj.read, "ply": ply.read, "stl": stl.read}


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read the visible content of a model.

    Raises
    ------
    SimgrabError
        Made by ``refuse``, for violations of the format and for required features that are not supported.
    """
    return _READERS[model.format](model, refuse)

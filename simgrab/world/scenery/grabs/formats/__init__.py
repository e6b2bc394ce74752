"""Files of 3-D models, each read by its format's standard into the same shapes."""

from simgrab.io.models import ModelFile
from simgrab.io.parse import Refuse
from simgrab.world.scenery.grabs.formats import gltf, obj, ply, stl
from simgrab.world.scenery.grabs.formats.contents import Contents

_READERS = {"glb": gltf.read, "gltf": gltf.read, "obj": obj.read, "ply": ply.read, "stl": stl.read}


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read what a model shows.

    Raises
    ------
    SimgrabError
        By ``refuse``, for what its format does not allow and for what it needs and is not supported.
    """
    return _READERS[model.format](model, refuse)

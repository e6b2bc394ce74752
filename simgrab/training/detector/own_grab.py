"""Frames of a user's own grab, for the detector to learn it."""

from __future__ import annotations

import msgspec

from simgrab.io.strict import convert
from simgrab.model import scenes
from simgrab.model.scenario import Mesh, Scenario, vary

FRAMES, CLIP_FRAMES = 960, 4  # 240 worlds
SIZE = (960, 540)  # the nets' crops of nearly every grab have fewer pixels still


def scene_of(grab: Mesh, *, frames: int = FRAMES, seed: int = 0) -> Scenario:
    """Give the scene `training` with one grab in all of its worlds, at half the size.

    The grab's appearance varies as in `training` where it is the default one.
    """
    training = scenes.load("training", {"frames": frames, "seed": seed, "clip.clip_frames": CLIP_FRAMES}, size=SIZE)
    values, fields = msgspec.to_builtins(grab), msgspec.structs.fields(grab)
    stated = {"model": values["model"]} | {
        field.name: values[field.name] for field in fields if getattr(grab, field.name) != field.default
    }
    return convert(vary.laid_over(msgspec.to_builtins(training), {"name": "own-grab", "grab": stated}), Scenario)

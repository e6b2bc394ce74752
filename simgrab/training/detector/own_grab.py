"""Frames of a user's own grab, for the detector to learn it."""

from __future__ import annotations

import msgspec

from simgrab import scenes
from simgrab.scenario import Mesh, Scenario
from simgrab.scenario.factor import JOINT

FRAMES, CLIP_FRAMES = 960, 4  # 240 worlds
SIZE = (960, 540)  # the nets' crops of nearly every grab have fewer pixels still
_PAINT = ("grab.paint_rgb", "grab.wear", "grab.residue")


def scene_of(grab: Mesh, *, frames: int = FRAMES, seed: int = 0) -> Scenario:
    """Give the scene `training` with one grab in all of its worlds, at half the size.

    Parameters
    ----------
    grab : Mesh
        Its paint varies where it has none of its own.
    frames : int
    seed : int
    """
    training = scenes.load("training", {"frames": frames, "seed": seed, "clip.clip_frames": CLIP_FRAMES}, size=SIZE)
    kept = {
        key: factor
        for key, factor in training.vary.items()
        if key != "grab" and (key in _PAINT or not any(part.startswith("grab.") for part in key.split(JOINT)))
    }
    return msgspec.structs.replace(training, name="own-grab", grab=grab, vary=kept)

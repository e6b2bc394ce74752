"""What a scene states without effect, and which of its frames are alike: worth a line before they are rendered."""

from __future__ import annotations

from collections import Counter
from functools import partial

import msgspec

from simgrab.errors import ScenarioError
from simgrab.io import models, photographs
from simgrab.model.scenario import Camera, Cycles, Dynamic, Iid, Mesh, OneOf, Scenario
from simgrab.model.scenario.factor import JOINT
from simgrab.model.truth import SPLITS
from simgrab.world.extensions import Recipe

FEW_WORLDS = 100
"""Beyond these, shares of worlds are close to those stated."""
READ_PX = 14
"""Height of digits in pictures of 640 x 360 px, all of which were read; of those of 11 px none was."""
FAR = 2.0
"""Ratio of a split's worlds to those stated, from which on it is named."""
_REFUSE = partial(ScenarioError, "place.file")


def notices(recipe: Recipe, *, splits: bool = True) -> list[str]:
    """Return a line for each thing that a user may not expect; ``splits``: whether frames are divided."""
    scenario = recipe.scenario
    if recipe.extensions.trajectory is None:
        lines = _of_independent(recipe) if isinstance(scenario.swing, Iid) else _of_clips(recipe)
    else:
        lines = []
    if isinstance(scenario.grab, Mesh):
        if isinstance(scenario.swing, Iid) and scenario.swing.load.support()[1]:
            lines.append("a grab from a file holds no load: swing.load is not used")
        if isinstance(scenario.swing, Dynamic) and isinstance(scenario.swing.work, Cycles):
            lines.append("a grab from a file holds no load: its mass is grab.mass_kg throughout the cycles")
    lines += _of_weather(scenario) + _of_display(scenario)
    return lines + (_of_photographs(recipe) + _of_splits(recipe) if splits else [])


def _of_independent(recipe: Recipe) -> list[str]:
    scenario, lines = recipe.scenario, list[str]()
    assert isinstance(scenario.swing, Iid)
    if scenario.camera.mount != Camera().mount:
        lines.append(
            'camera.mount is only stated in camera.toml: in independent frames (swing.model = "iid") nothing moves the '
            "camera"
        )
    world = scenario.clip.clip_frames if recipe.varies else scenario.frames
    if scenario.swing.absent * min(world, scenario.frames) > 1:
        lines.append(
            f"swing.absent: frames without the grab are one picture in each world of {world} frames, but for noise, "
            "rain, snow and the display; "
            + ("lower clip.clip_frames" if recipe.varies else "give the scene [vary] and clip.clip_frames")
        )
    return lines


def _of_weather(scenario: Scenario) -> list[str]:
    weather = scenario.weather
    carried = weather.rain_mm_h, weather.snow_mm_h, weather.dust_thickness, weather.drift_thickness
    if not weather.wind_m_s or any(carried) or any("weather" in key for key in scenario.vary):
        return []
    return ["weather.wind_m_s has no effect without rain, snow or dust; the wind of swing.wind pushes a moving grab"]


def _of_display(scenario: Scenario) -> list[str]:
    layout = scenario.display.layout_in(scenario.camera.width_px, scenario.camera.height_px)
    if layout is None or layout.digit_height_px >= READ_PX:
        return []
    return [
        f"display: digits {layout.digit_height_px} px high are hardly read by the bundled reader; it reads {READ_PX} px"
    ]


def _of_clips(recipe: Recipe) -> list[str]:
    scenario, swing = recipe.scenario, recipe.scenario.swing
    assert isinstance(swing, Dynamic)
    clips = scenario.clip_count
    wind, vibration = swing.wind, scenario.camera.mount.vibration
    random = (wind.mean_m_s * wind.intensity, swing.forcing.rms_m_s2, vibration.rms_deg)
    if clips == 1 or recipe.varies or any(random) or (isinstance(swing.work, Cycles) and swing.work.variation):
        return []
    return [
        f"all {clips} clips have the same motion, since nothing in it is random: set swing.wind.mean_m_s or "
        "swing.forcing.rms_m_s2, or give the scene [vary]"
    ]


def _of_photographs(recipe: Recipe) -> list[str]:
    """Name photographs that frames of several splits show."""
    scenario = recipe.scenario
    parts, named, step = len(scenario.splits.shares), _photographs(scenario), 1
    if recipe.varies or not isinstance(scenario.swing, Iid):
        step = scenario.clip.clip_frames or scenario.frames
    frames = range(0, scenario.frames, step)  # the first of each unit that has a split
    if parts == 1 or not named or all(recipe.split(frame) == recipe.split(0) for frame in frames):
        return []
    lines = list[str]()
    for sha256, file in named.items():
        shown = photographs.Sequence(models.recall(sha256, file, _REFUSE), _REFUSE)
        if not shown.shared_out(scenario.splits.shares):
            what = "a video" if shown.is_video else f"{len(shown)} photograph{'s' * (len(shown) > 1)}"
            lines.append(
                f"splits: {file}: {what} for {parts} splits, which show the same; use a folder of {parts} photographs "
                "or more"
            )
    return lines


def _photographs(scenario: Scenario) -> dict[str, str]:
    """By the SHA-256 of the photographs that frames may show, the name of their file."""
    drawn = [(key, factor.values) for key, factor in scenario.vary.items() if isinstance(factor, OneOf)]
    places = [
        value["place"] if JOINT in key else value
        for key, values in drawn if "place" in key.split(JOINT) for value in values
    ]  # fmt: skip
    places = places or [msgspec.to_builtins(scenario.place)]
    return {place["sha256"]: place["file"] for place in places if place.get("model") == "photo"}


def _of_splits(recipe: Recipe) -> list[str]:
    """Name a lack of frames to train on, and shares that are not as stated, as each of few worlds lies in one split."""
    scenario = recipe.scenario
    if not scenario.splits.train:
        return [
            "splits: no frame is for training, and data.yaml names those of another split there, as trainers need some"
        ]
    clips = scenario.clip_count
    worlds = scenario.slowest_draw(clips - 1) + 1
    if not 1 < worlds <= FEW_WORLDS or (isinstance(scenario.swing, Iid) and not recipe.varies):
        return []
    firsts = {scenario.slowest_draw(clip): scenario.span(clip).start for clip in reversed(range(clips))}
    found = Counter(recipe.split(frame) for frame in firsts.values())
    stated = [(name, worlds * getattr(scenario.splits, name)) for name in SPLITS]
    if all(share / FAR <= found[name] <= share * FAR for name, share in stated):
        return []
    got = ", ".join(f"{name} {found[name]} (stated {share:g})" for name, share in stated)
    return [
        f"splits: a world has one split, and few worlds miss the stated shares: {got}; render more "
        "frames, set a smaller clip.clip_frames, or another seed"
    ]

"""The exam scenes ask what training never shows."""

from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scripts import background_photographs, build_weights, hanging_shapes
from scripts.background_photographs import SCENE
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.factor import JOINT

EXAMS = [name for name in scenes.names() if name.startswith("exam-")]
FAMILIES = ("scissors", "large", "known")
WEATHERS = ("calm", "windy", "night-snow", "heavy-snow", "rain", "fog-dust", "glare")
LEARNED = ("training", "training-shapes", "training-large")
SOURCES = (*build_weights.DETECTOR, build_weights.FOUR_ROPE, build_weights.READER)
LEAST_APART = 0.15  # of two paints, in RGB's cube of side 1

load = cache(scenes.load)


def values(scene: Scenario, key: str) -> list:
    """Every value that a key takes in a scene."""
    for name, factor in scene.vary.items():
        parts = name.split(JOINT)
        if key in parts:
            return [value[key] if len(parts) > 1 else value for value in factor.values]
    raise AssertionError(f"{key} does not vary in {scene.name}")


def cargoes(scene: Scenario) -> set[str]:
    """What lies about and hangs in the grab; places without a word about it show none, but for the quay's coal."""
    lying = {place.get("cargo", "coal") for place in values(scene, "place") if place["model"] in ("quay", "hold")}
    return lying | set(values(scene, "grab.cargo"))


def test_there_is_an_exam_for_each_weather():
    assert set(EXAMS) == {f"exam-{name}" for name in (*WEATHERS, *(f"family-{family}" for family in FAMILIES))}
    assert len({load(name).seed for name in EXAMS} | {load("training").seed}) == len(EXAMS) + 1
    learned = {source.seed for source in (*SOURCES, *build_weights.MORE)}
    assert not {load(name).seed for name in EXAMS} & learned  # a seed draws the same worlds in any scene


def test_what_weights_are_built_of_can_be_drawn(tmp_path, monkeypatch):
    for name in (build_weights.BACKGROUNDS, build_weights.COLLAGES, build_weights.SHAPES, *build_weights.NEGATIVES):
        folder = tmp_path / name
        (folder / "photographs").mkdir(parents=True)
        (folder / SCENE).write_bytes(Path(build_weights.__file__).with_name(SCENE).read_bytes())
        Image.new("RGB", (64, 36)).save(folder / "photographs" / "yard.png")
    monkeypatch.setattr(hanging_shapes, "OWN", 2)
    monkeypatch.setattr(hanging_shapes, "collected", lambda _: [("one", hanging_shapes.plain(stream(0, 0, "shape")))])
    hanging_shapes.prepare(tmp_path / build_weights.SHAPES)
    for source, quick in product(SOURCES, (False, True)):
        drawn = build_weights.scenario(source, tmp_path, quick=quick)
        assert (drawn.seed, drawn.frames) == (source.seed, source.quick if quick else source.frames)
        for key, names in source.kept.items():
            assert len(values(drawn, key)) == len(names) < len(values(load(source.scene), key))


def test_collages_show_patches_of_several_crops(tmp_path, monkeypatch):
    monkeypatch.setattr(background_photographs, "COLLAGES", 12)
    crops = tmp_path / "crops" / "photographs"
    crops.mkdir(parents=True)
    greys = (20, 90, 160, 230)
    for grey in greys:
        Image.new("RGB", background_photographs.SIZE, (grey, grey, grey)).save(crops / f"{grey}.jpg")
    written = [
        background_photographs.prepare_collages(crops.parent, tmp_path / name).with_name("photographs")
        for name in ("one", "two")
    ]
    files = [{file.name: file.read_bytes() for file in folder.glob("*.jpg")} for folder in written]
    assert files[0] == files[1]
    pictures = [np.asarray(Image.open(written[0] / name).convert("RGB"), int) for name in files[0]]
    assert len(pictures) == 12
    shares = [max(np.mean((np.abs(p - grey) < 3).all(axis=2)) for grey in greys) for p in pictures]
    assert 0.2 < np.mean(shares) < 0.98  # the rest is of patches
    assert any((p.max(axis=2) - p.min(axis=2) > 20).any() for p in pictures)  # of a colour


@pytest.mark.parametrize("learned", LEARNED)
@pytest.mark.parametrize("name", EXAMS)
def test_an_exam_shares_no_key_for_paint_cargo_place_or_display_with_training(name, learned):
    exam, training = load(name), load(learned)
    paints = product(values(exam, "grab.paint_rgb"), values(training, "grab.paint_rgb"))
    assert min(np.linalg.norm(np.subtract(a, b)) for a, b in paints) > LEAST_APART
    assert not cargoes(exam) & cargoes(training)
    places = [place for place in values(exam, "place") if place != {"model": "plain"}]  # which has no parameters
    assert not [place for place in places if place in values(training, "place")]
    for key in ("jib.head_height_m", "display.start"):
        assert not set(values(exam, key)) & set(values(training, key)), key


@pytest.mark.parametrize("name", EXAMS)
def test_an_exam_is_a_test_set_of_many_worlds_and_a_third_lacks_the_grab(name):
    exam = load(name)
    assert (exam.frames, exam.clip.count(exam.frames), exam.splits.test) == (1500, 100, 1.0)
    assert exam.swing.absent == pytest.approx(1 / 3, abs=1e-3)


def kinds(scene: Scenario) -> set[str]:
    """Kinds of grabs that hang in a scene."""
    return {value["model"] for value in values(scene, "grab")}


@pytest.mark.parametrize(("learned", "more"), [(LEARNED[0], set()), (LEARNED[1], {"assembled"})])
def test_training_never_draws_the_exams_kind_of_grab_or_size(learned, more):
    training = load(learned)
    assert kinds(load("exam-family-scissors")) == {"scissors"}
    assert kinds(training) == {"four-rope", "clamshell", "orange-peel"} | more
    assert {kind for drawn in values(training, "clutter.kinds") for kind in drawn} == kinds(training)
    assert kinds(load("exam-family-known")) == kinds(training) - {"four-rope"} - more
    largest = training.vary["grab.volume_m3"].support()[1]
    assert load("exam-family-large").vary["grab.volume_m3"].support()[0] > largest


@pytest.mark.parametrize("family", FAMILIES)
def test_grabs_of_other_kinds_stand_about_in_a_family_exam(family):
    exam = load(f"exam-family-{family}")
    assert all(len(drawn) == 4 for drawn in values(exam, "clutter.kinds"))
    assert max(values(exam, "clutter.other_grabs")) > 1

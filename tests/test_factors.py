"""The factor report accepts what was asked for, and tells of what was not."""

import numpy as np

from scripts.factors import factor, law, report
from simgrab.model import scenes
from simgrab.model.distributions import Choice, Rayleigh, Uniform
from simgrab.model.scenario import OneOf

RNG = np.random.default_rng(4)
COINS = OneOf(("heads", "tails"), weights=(1.0, 3.0))


def test_draws_of_the_law_pass_and_of_another_fail():
    asked = [Uniform(0.0, 1.0)] * 100 + [Uniform(5.0, 9.0)] * 100
    drawn = [float(one.sample(RNG)) for one in asked]
    assert not law("mixed", asked, drawn).warnings
    assert law("squared", asked[:100], list(np.square(drawn[:100]))).p < 0.01
    swings = [float(Rayleigh(1.0).sample(RNG)) for _ in range(300)]
    assert law("swing", [Rayleigh(2.0)] * 300, swings).p < 1e-6


def test_gaps_are_told():
    drawn = [v for v in RNG.uniform(0, 1, 400) if not 0.29 < v < 0.41]
    assert any("gap" in w and "30-40 %" in w for w in law("holed", [Uniform(0.0, 1.0)] * len(drawn), drawn).warnings)
    assert "gap: never 'tails'" in factor("coin", COINS, ["heads"] * 20).warnings
    assert "gap: never '7'" in law("jaw", [Choice((0.0, 7.0))] * 40, [0.0] * 40).warnings


def test_choices_pass_by_their_shares_and_strangers_are_told():
    fair = ["heads"] * 25 + ["tails"] * 75
    assert factor("coin", COINS, fair).p > 0.9
    assert factor("coin", COINS, ["heads"] * 75 + ["tails"] * 25).p < 1e-6
    assert any("edge" in w for w in factor("coin", COINS, [*fair, "edge"]).warnings)


def test_the_training_scene_draws_what_it_asks_for():
    lines = report(scenes.load("training", {"seed": 0, "frames": 800}))
    assert [(line.name, line.warnings) for line in lines if line.warnings] == []
    assert len(lines) > 30

import numpy as np
import pytest

from simgrab.model.rng import derive, stream


def test_streams_are_repeatable_and_apart():
    draws = {
        (seed, index, name): tuple(stream(seed, index, name).random(4))
        for seed in (0, 1) for index in (0, 1, 812) for name in ("alpha", "gamma")
    }  # fmt: skip
    assert len(set(draws.values())) == len(draws)
    assert draws[0, 812, "alpha"] == tuple(stream(0, 812, "alpha").random(4))


def test_first_draws_over_frames_are_uncorrelated():
    sample = np.array([stream(0, i, "alpha").normal() for i in range(4000)])
    assert abs(np.corrcoef(sample[:-1], sample[1:])[0, 1]) < 0.05
    assert abs(sample.mean()) < 0.05


def test_derived_seeds_are_repeatable_and_apart():
    seeds = {(seed, name): derive(seed, name) for seed in range(50) for name in ("calm", "night", "calm ")}
    assert len(set(seeds.values())) == len(seeds)
    assert all(50 <= seed < 2**53 for seed in seeds.values())
    assert seeds[7, "night"] == derive(7, "night") == 544175216655781


def test_negative_seed_is_refused():
    with pytest.raises(ValueError, match="seed"):
        stream(-1, 0, "alpha")

"""A controller's data with one mistake in their description: the swing does not follow, and the mistake is named."""

from dataclasses import replace

import numpy as np
import pytest
import swinging
from scipy.signal import lfilter

from simgrab.instrument.estimate import PendulumSmoother, RopeAware
from simgrab.instrument.estimate.doubts import doubt, follows
from simgrab.instrument.estimate.pendulum_smoother import NOT_CONVERGED
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.model.records.estimates import Estimate
from tests.instrument.test_controller_fusion import controller

REFUSED = Estimate(status="refused", reason=NOT_CONVERGED)
FORCED = Estimate(diagnostics={"forcing": 1e-2, "lean_sd": 5e-3, "follows": 0.0, "longer_m": -1.6})


def given(mount, seed):
    crane = swinging.record(fixed=False, frames=400, seed=seed, camera__mount={"model": mount})
    pixels = crane.pixels + np.random.default_rng(3).normal(0, 1.3, crane.pixels.shape)
    record = PixelRecord(
        pixels=pixels, pixel_sd=np.full(len(pixels), 1.3), rope_length=np.round(crane.rope, 2), time=crane.time
    )
    reports = replace(controller(crane.time, crane.jib), clock_sd_s=0.1)
    return record, crane.calibration, reports


def test_what_follows_is_not_doubted():
    record, camera, reports = given("rigid", 102)
    estimator = PendulumSmoother(controller=reports, wander_px=1.3)
    found = estimator.estimate(record.pixels, camera, rope_length=record.rope_length, time=record.time)
    assert follows(found)
    assert doubt(estimator, record, camera, found) == ""
    assert doubt(replace(estimator, controller=None), record, camera, REFUSED) == ""
    assert doubt(RopeAware(), record, camera, REFUSED) == ""
    assert doubt(estimator, record, camera, replace(REFUSED, reason="the controller reports from 3 to 4 s")) == ""


@pytest.mark.parametrize(
    ("mount", "seed", "mistake", "named"),
    [
        ("levelled", 101, lambda c: replace(c, slew=-c.slew), "follows with slew.clockwise the other way round"),
        ("fixed", 103, lambda c: replace(c, slew=c.slew * np.pi / 180), "angles in rad"),
        ("rigid", 102, lambda c: replace(c, slew=c.slew[::-1].copy()), "radius or luff, offset_m, the rope's length"),
    ],
)
def test_a_mistake_that_alone_explains_it_is_named(mount, seed, mistake, named):
    record, camera, reports = given(mount, seed)
    estimator = PendulumSmoother(controller=mistake(reports), wander_px=1.3)
    said = doubt(estimator, record, camera, FORCED)
    assert said.startswith("the swing does not follow the controller's motion")
    assert named in said
    if seed == 102:
        assert doubt(estimator, record, camera, REFUSED) == said.partition(": ")[2]
        coarse = replace(estimator, controller=replace(estimator.controller, slew_sd=0.2 * np.pi / 180))
        assert "put them 9 cm off each" in doubt(coarse, record, camera, REFUSED)


@pytest.mark.parametrize(("px", "explained"), [(4.0, True), (8.0, False)])
def test_errors_of_pixels_that_last_and_are_not_stated_are_no_contradiction(px, explained):
    record, camera, reports = given("levelled", 101)
    lasting = px * lfilter([0.15], [1.0, -0.99], np.random.default_rng(4).normal(size=record.pixels.shape), axis=0)
    record = replace(record, pixels=record.pixels + lasting)
    estimator = PendulumSmoother(controller=reports)
    found = estimator.estimate(record.pixels, camera, rope_length=record.rope_length, time=record.time)
    assert follows(found) == explained
    assert doubt(estimator, record, camera, found) == ""

"""What an axis turns up is what is drawn."""

import math

import msgspec
import numpy as np
import pytest
from stress_runs import bundled, small

from simgrab.errors import StressError
from simgrab.lab.stress import catalogue, geometric, swings
from simgrab.lab.stress.laws import LAWS
from simgrab.lab.stress.study import situation
from simgrab.lab.stress.swings import Draws

DEG = math.pi / 180


def having(n=4000, **axes):
    study = small("planted", n=n, given={name.replace("_", "-"): value for name, value in axes.items()})
    return situation(study, (0.0,))


def motion(n=4000, trials=10, **axes):
    return swings.draw(having(n, **axes), Draws(0, range(trials), n))


def records(n=2000, trials=10, **axes):
    return geometric.draw(having(n, **axes), 0, range(trials))


@pytest.mark.parametrize("law", LAWS)
def test_sigma_is_the_root_mean_square_whatever_the_law(law):
    drawn = motion(trials=50, alpha_law=law)
    assert np.sqrt(np.mean(drawn.alpha**2)) == pytest.approx(2 * DEG, rel=0.02)
    assert np.all(drawn.sigma == pytest.approx(2 * DEG))
    assert np.all(drawn.alpha >= 0)
    if law != "student":  # whose fourth moment hardly converges
        kurtosis = np.mean(drawn.alpha**4) / np.mean(drawn.alpha**2) ** 2
        assert kurtosis == pytest.approx(LAWS[law].kurtosis, rel=0.05)


@pytest.mark.parametrize(("axis", "direction"), [("gamma_towards", 0.0), ("gamma_across", np.pi / 2)])
def test_von_mises(axis, direction):
    from scipy.special import ive

    drawn = motion(**{axis: 1.0})
    mean = np.mean(np.exp(1j * drawn.azimuth))
    assert abs(mean) == pytest.approx(ive(1, 1) / ive(0, 1), abs=0.01)
    assert np.angle(mean) == pytest.approx(direction, abs=0.03)


def test_axial_and_elliptic_swings_have_no_side_but_a_line():
    for axes in ({"gamma_axial": 2.0}, {"gamma_ellipse": 0.6}):
        drawn = motion(**axes)
        x, y = drawn.alpha * np.cos(drawn.azimuth), drawn.alpha * np.sin(drawn.azimuth)
        assert abs(x.mean()) < 4 * x.std() / 200
        assert np.mean(x**2) > 1.5 * np.mean(y**2)
        assert np.sqrt(np.mean(drawn.alpha**2)) == pytest.approx(2 * DEG, rel=0.03)


def test_swings_towards_the_tilt_grow():
    drawn = motion(gamma_alpha=0.5)
    side = np.cos(drawn.azimuth) > 0
    assert drawn.alpha[side].mean() > 1.5 * drawn.alpha[~side].mean()
    assert np.sqrt(np.mean(drawn.alpha**2)) == pytest.approx(2 * DEG, rel=0.02)


def correlation(values, lag=1):
    return np.mean(values[:, lag:] * values[:, :-lag]) / np.mean(values**2)


def test_successive_frames_are_as_alike_as_asked():
    drawn = motion(ar1=0.9)
    unit = np.exp(1j * drawn.azimuth)
    assert np.real(np.mean(unit[:, 1:] * unit[:, :-1].conj())) == pytest.approx(0.9, abs=0.01)
    assert np.mean(drawn.alpha**2) == pytest.approx((2 * DEG) ** 2, rel=0.1)


def test_a_forced_pendulum_swings_at_its_period_and_forgets():
    drawn = motion(n=6000, trials=40, memory=20.0)
    x = drawn.alpha * np.cos(drawn.azimuth)
    assert np.mean(drawn.alpha**2) == pytest.approx((2 * DEG) ** 2, rel=0.1)
    period = round(9 * 2 * np.pi / np.sqrt(9.81 / 20))  # frames
    assert correlation(x, period) == pytest.approx(np.exp(-period / 9 / 20), abs=0.06)
    assert correlation(x, period // 2) < -0.6


def test_leans_add_up_as_vectors():
    drawn = motion(lean_along=1.2, lean_across=-0.5)
    x, y = drawn.alpha * np.cos(drawn.azimuth), drawn.alpha * np.sin(drawn.azimuth)
    assert (x.mean() / DEG, y.mean() / DEG) == pytest.approx((1.2, -0.5), abs=0.05)
    assert drawn.sigma[0] == pytest.approx(math.sqrt(4 + 1.44 + 0.25) * DEG)
    assert motion(n=10, wind=20.0).sigma[0] > motion(n=10, wind=10.0).sigma[0]
    assert motion(n=10, slewing=1.2).sigma[0] == pytest.approx(math.hypot(2, 2.3) * DEG, rel=0.01)  # FACTS of cranes


def test_ropes_are_reported_late_wrong_and_misread():
    plain = records(rope_range=20.0)
    assert np.array_equal(records(rope_range=20.0, rope_bias=0.5).rope, plain.rope + 0.5)
    misread = records(rope_range=20.0, rope_misread=0.1)
    assert np.mean(misread.rope != plain.rope) == pytest.approx(0.1, abs=0.01)
    late = having(rope_range=20.0, rope_lag=1.0)
    draws = Draws(0, range(3), late.frames)
    true = swings.draw(late, draws).rope
    np.testing.assert_allclose(swings.reported_rope(late, draws, true)[:, 9:], true[:, :-9], atol=1e-9)


def test_far_swings_are_missed_more_often():
    found = records(n=20000, sigma=5.0, missing_far=0.9)
    gone = np.isnan(found.pixels[..., 0])
    near, far = found.alpha < 1 * DEG, np.abs(found.alpha - 10 * DEG) < 0.5 * DEG
    assert gone[far].mean() == pytest.approx(0.9, abs=0.02)
    assert gone[near].mean() < 0.15


@pytest.mark.parametrize(("axis", "value", "spread"), [("noise", 2.0, 2.0), ("noise_slow", 2.0, 2.0)])
def test_noise_has_its_size(axis, value, spread):
    off = (records(n=20000, **{axis: value}).pixels - records(n=20000).pixels)[..., 0]
    assert off.std() == pytest.approx(spread, rel=0.1)
    assert (correlation(off) > 0.9) == (axis == "noise_slow")


def test_the_box_is_as_far_off_as_facts_say():
    """0.42° at l = 10 m and α = 10°, 0.04° at 30 m, a camera hanging straight."""
    for rope, most in ((10.0, 0.42), (30.0, 0.04)):
        centre, box = (records(n=10, rope=rope, beta=0.0, box_centre=share) for share in (0.0, 1.0))
        rays = [np.arccos(centre.calibration.intrinsics.rays(r.probe_pixels)[..., 2]) for r in (centre, box)]
        assert np.abs(rays[1] - rays[0]).max() / DEG == pytest.approx(most, abs=0.03)


def test_the_camera_moves_as_its_mount_does():
    here = having(vibration=0.2)
    still = geometric.draw(having(), 0, range(5)).pixels
    moved = geometric.draw(here, 0, range(5)).pixels
    assert (moved - still).std() / here.lens.f_px / DEG == pytest.approx(0.2, rel=0.05)
    rigid = geometric.draw(having(luffing=2.0), 0, range(5)).pixels - still
    assert np.abs(rigid).max() / here.lens.f_px / DEG == pytest.approx(2.0, rel=0.1)  # ±1 m at 2° a metre


def test_physics_brings_its_own_mount():
    study = small("mount", n=40)
    fixed, rigid = (
        swings.draw(situation(msgspec.structs.replace(study, given={"motion": "work-cycles"}), (m,)), Draws(0, [0], 40))
        for m in ("fixed", "rigid")
    )
    assert fixed.tilt is None
    assert rigid.tilt is not None
    np.testing.assert_array_equal(fixed.alpha, rigid.alpha)


def test_probes_are_swings_of_ten_degrees_all_around():
    found = records(n=20)
    rays = found.calibration.intrinsics.rays(found.probe_pixels)
    from simgrab.model.geometry import camera_rotation

    down = camera_rotation(found.beta, found.azimuth, 0.0).T @ (0.0, 0.0, -1.0)
    np.testing.assert_allclose(np.degrees(np.arccos(rays @ down)), 10.0, atol=1e-9)


def test_each_replication_of_physics_begins_at_another_time_of_the_same_motion():
    at = situation(msgspec.structs.replace(small("mount", n=10), given={"motion": "free-swing"}), ("fixed",))
    found = geometric.draw(at, 0, [0, 1, 2])
    np.testing.assert_array_equal(geometric.draw(at, 0, [1]).alpha[0], found.alpha[1])
    first, *others = found.alpha
    assert all(np.abs(first - other).max() > 0.1 * DEG for other in others)
    assert found.alpha.max() < 6 * DEG  # it was let go at 6 degrees


@pytest.mark.parametrize(
    ("over", "axes"),
    [
        ("motion", {"motion": "wind-only", "wind": 12.0}),
        ("motion", {"motion": "work-cycles", "sigma": 4.0}),
        ("motion", {"motion": "work-cycles", "rope": 20.0}),
        ("motion", {"motion": "work-cycles", "swing.rope_length_m": 20.0}),
        ("mount", {"mount": "levelled", "vibration": 0.1}),
    ],
)
def test_what_physics_overrides_is_refused(over, axes):
    *_, name = axes
    with pytest.raises(StressError, match=rf"^{name}: has no effect, because the .*'{axes[over]}'"):
        situation(small("planted", n=10, given=axes), (0.0,))
    kept = {"motion": "work-cycles", "wind": 0.0, "sigma": 2.0, "vibration": 0.1, "rope-lag": 1.0}
    assert situation(small("planted", n=10, given=kept), (0.0,)).tremble > 0


@pytest.mark.parametrize(
    "given",
    [
        {"memory": 5.0, "ar1": 0.9}, {"memory": 5.0, "alpha-law": "bursts"}, {"ar1": 0.9, "gamma-axial": 1.0},
        {"alpha-student": 0.2, "alpha-law": "rayleigh"}, {"gamma-towards": 1.0, "gamma-across": 1.0},
        {"gamma-axial": 1.0, "gamma-towards": 0.0},
        {"memory": 5.0, "gamma-alpha": 0.5}, {"rope": 20.0, "rope-range": 4.0},
    ],
)  # fmt: skip
def test_of_axes_that_draw_the_same_only_one_is_turned_up(given):
    with pytest.raises(StressError, match=f"{' and '.join(given)} exclude each other"):
        situation(small("planted", n=10, given=given), (0.0,))
    first, *_ = given
    assert situation(small("planted", n=10, given={first: given[first]}), (0.0,))


def test_a_pendulum_is_not_damped_beyond_swinging():
    with pytest.raises(StressError, match=r"memory: must be 0, or 1\.5 or more"):
        situation(small("planted", n=10, given={"memory": 1.0}), (0.0,))


@pytest.mark.parametrize("name", [name for name in catalogue.of("geometric") if name != "convergence"])
def test_every_bundled_study_draws_replications(name):
    study = msgspec.structs.replace(bundled(name), n=10)
    for point in study.points[:: max(len(study.points) // 4, 1)]:
        made = situation(study, point)
        if made.frames <= 3699:
            assert geometric.draw(made, 0, [0, 1]).alpha.shape == (2, made.frames)

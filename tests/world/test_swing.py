import numpy as np
import pytest
from conftest import small_scene
from scipy import stats

from simgrab.errors import ScenarioError
from simgrab.model.rng import stream
from simgrab.world.extensions import Recipe
from simgrab.world.trajectory.iid import CLOSED, draw


@pytest.fixture(scope="module")
def moments(scene):
    return [draw(scene, frame) for frame in range(3000)]


def test_the_papers_law(moments):
    alpha = np.degrees([m.grab.alpha for m in moments])
    assert stats.kstest(alpha, stats.halfnorm(scale=2.0).cdf).pvalue > 1e-3
    gamma = np.degrees([m.gamma for m in moments])
    assert stats.kstest(gamma, stats.uniform(0, 360).cdf).pvalue > 1e-3
    assert abs(stats.spearmanr(alpha, gamma).statistic) < 0.06


def test_frames_are_made_alone_and_variables_do_not_disturb_each_other(moments):
    assert draw(small_scene(), 812) == moments[812]
    other = draw(small_scene(swing__yaw_deg={"dist": "constant", "value": 3.0}), 812)
    assert other.grab.yaw == pytest.approx(np.radians(3))
    same = moments[812]
    assert (other.grab.alpha, other.gamma, other.grab.rope_length) == (
        same.grab.alpha, same.gamma, same.grab.rope_length,
    )  # fmt: skip


def test_an_open_grab_holds_nothing(moments):
    assert all(m.grab.load == 0 for m in moments if m.grab.jaw > CLOSED)
    assert any(m.grab.load > 0 for m in moments)


def test_gamma_counts_from_the_tilt_azimuth():
    moment = draw(small_scene(camera__tilt_azimuth_deg=70.0), 5)
    assert (moment.grab.azimuth - moment.gamma) % (2 * np.pi) == pytest.approx(np.radians(70))


def test_splits_follow_their_shares(scene):
    names = [Recipe(scene).split(f) for f in range(4000)]
    for name, share in (("train", 0.8), ("val", 0.1), ("test", 0.1)):
        assert names.count(name) / 4000 == pytest.approx(share, abs=0.02)


def test_a_law_without_bounds_is_refused_where_it_goes_too_far():
    wild = small_scene(swing__alpha={"sigma_deg": 30.0, "law": {"dist": "exponential"}})
    wildest = max(range(500), key=lambda f: abs(float(wild.swing.alpha.law.sample(stream(0, f, "swing.alpha")))))
    with pytest.raises(ScenarioError, match=f"frame {wildest} has alpha"):
        draw(wild, wildest)

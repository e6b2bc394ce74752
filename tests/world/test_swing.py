import numpy as np
import pytest
from conftest import small_scene
from scipy import stats

from simgrab.errors import ScenarioError
from simgrab.rng import stream
from simgrab.world.meshes.grab import MAX_JAW
from simgrab.world.swing import CLOSED, draw, split


@pytest.fixture(scope="module")
def states(scene):
    return [draw(scene, frame, most_jaw=MAX_JAW) for frame in range(3000)]


def test_the_papers_law(states):
    alpha = np.degrees([s.alpha for s in states])
    assert stats.kstest(alpha, stats.halfnorm(scale=2.0).cdf).pvalue > 1e-3
    gamma = np.degrees([s.gamma for s in states])
    assert stats.kstest(gamma, stats.uniform(0, 360).cdf).pvalue > 1e-3
    assert abs(stats.spearmanr(alpha, gamma).statistic) < 0.06


def test_frames_are_made_alone_and_variables_do_not_disturb_each_other(states):
    assert draw(small_scene(), 812, most_jaw=MAX_JAW) == states[812]
    other = draw(small_scene(swing__yaw_deg={"dist": "constant", "value": 3.0}), 812, most_jaw=MAX_JAW)
    assert other.yaw == pytest.approx(np.radians(3))
    assert (other.alpha, other.gamma, other.rope_length) == (
        states[812].alpha, states[812].gamma, states[812].rope_length,
    )  # fmt: skip


def test_an_open_grab_holds_nothing(states):
    assert all(s.load == 0 for s in states if s.jaw > CLOSED)
    assert any(s.load > 0 for s in states)


def test_gamma_counts_from_the_tilt_azimuth():
    state = draw(small_scene(camera__tilt_azimuth_deg=70.0), 5, most_jaw=MAX_JAW)
    assert (state.azimuth - state.gamma) % (2 * np.pi) == pytest.approx(np.radians(70))


def test_splits_follow_their_shares(scene):
    names = [split(scene, f) for f in range(4000)]
    for name, share in (("train", 0.8), ("val", 0.1), ("test", 0.1)):
        assert names.count(name) / 4000 == pytest.approx(share, abs=0.02)


def test_a_law_without_bounds_is_refused_where_it_goes_too_far():
    wild = small_scene(swing__alpha={"sigma_deg": 30.0, "law": {"dist": "exponential"}})
    wildest = max(range(500), key=lambda f: abs(float(wild.swing.alpha.law.sample(stream(0, f, "swing.alpha")))))
    with pytest.raises(ScenarioError, match=f"frame {wildest} draws alpha"):
        draw(wild, wildest, most_jaw=MAX_JAW)

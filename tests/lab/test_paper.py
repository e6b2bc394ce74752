import re

import numpy as np
import pytest
from equations import eq1_residual, eq2_cos_alpha
from hypothesis import given
from hypothesis import strategies as st

from simgrab.lab.paper import paper
from simgrab.lab.paper.law import AXIS_DIRECTION, camera, draw
from simgrab.lab.paper.paper import PaperSettings
from simgrab.lab.paper.run import run
from simgrab.lab.paper.table import INCONSISTENT, rows

SMALL = PaperSettings(replications=60, frames=(50, 200, 800), starts_deg=(0, 5, 9, 10, 12))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("paper")


@pytest.fixture(scope="module")
def study(folder):
    return run(folder, SMALL)


def test_the_draws_are_the_papers_model():
    beta, sigma, h = np.deg2rad(5), np.deg2rad(2), 1600.0
    pixels, alpha = draw(0, "law", 20, 5000, beta=beta, sigma=sigma, h=h)
    m, theta = camera(h).intrinsics.polar(pixels, AXIS_DIRECTION)
    np.testing.assert_allclose(eq2_cos_alpha(m, theta, beta, h), np.cos(alpha), atol=1e-12)
    assert np.sqrt(np.mean(alpha**2)) == pytest.approx(sigma, rel=0.01)
    gamma = np.arctan2(
        m * np.sin(theta), h * np.sin(beta) - m * np.cos(theta) * np.cos(beta)
    )  # C lies beyond C' from G'
    np.testing.assert_allclose(eq1_residual(m, alpha, gamma, beta, h), 0, atol=1e-9)
    assert abs(np.exp(1j * gamma).mean()) < 0.01  # uniform


def test_the_study_measures_what_it_says(study):
    assert study.slope_beta == pytest.approx(-0.5, abs=0.1)
    assert study.mean_cos == pytest.approx(study.expected_cos, abs=1e-4)
    assert max(study.iterations) <= 8
    assert sum(study.iterations.values()) == 60
    beta = study.beta_steps
    assert np.all(beta[:, 4] < beta[:, 3])
    assert np.nanmax(beta[:, 6:]) < 1e-6
    refused = {s.start_deg: s.refused for s in study.starts}
    assert refused[0] == refused[5] == refused[9] == 0
    assert 0 < refused[10] < 60
    assert refused[12] == 60
    assert max(s.apart for s in study.starts if s.start_deg <= 9) < 1e-9
    for n in SMALL.frames:
        assert study.median[n].beta.rms < study.known[n].beta.rms
        assert study.estimated[n].beta.rms == pytest.approx(study.known[n].beta.rms, rel=0.05)


def test_convergence_does_not_depend_on_the_last_bit():
    pixels, _ = draw(0, "convergence", 60, 800, beta=np.deg2rad(5), sigma=np.deg2rad(2), h=1600.0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        rounded = np.nextafter(pixels, rng.choice([-np.inf, np.inf], pixels.shape))
        assert paper.LIMIT.batch(rounded, camera(1600.0)).ok.all()


def test_published_beside_measured(study):
    table = {row.quantity: row for row in rows(study)}
    assert table["iterations until converged"].published == "within 8"
    assert table["pixel density d0 (px/mm)"].measured == "342.60"
    assert table["focal length h (px)"].measured == "1644.82"
    assert float(table["m above 300 px"].measured.split()[0]) < 0.8  # half-normal tails are too thin for the video
    published = " ".join(row.published for row in rows(study))
    for number in ("0.026–0.065, median 0.028", "28 to 182", "10.010", "2.987e-9", "2.131e-9", "2.878"):
        assert number in published
    assert len(INCONSISTENT) >= 6


def test_figures_and_a_page_that_needs_no_other_file(study, folder):  # noqa: ARG001
    page = (folder / "paper.html").read_text(encoding="utf-8")
    for name in ("errors", "convergence", "starts", "rivals"):
        for ending in ("svg", "png"):
            assert (folder / f"{name}.{ending}").stat().st_size > 5000
    assert page.count("<svg") == 4
    assert not re.search(r"""(src|href)\s*=\s*["'](?!\#)""", page.replace("xlink:href", "href"))
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for used in set(re.findall(r'href="#([^"]+)"', page)) | set(re.findall(r"url\(#([^)]+)\)", page)):
        assert used in ids


def test_a_seed_is_a_study():
    one, other = (draw(3, "x", 2, 10, beta=0.1, sigma=0.03, h=1600)[0] for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert not np.allclose(one, draw(4, "x", 2, 10, beta=0.1, sigma=0.03, h=1600)[0])


@given(st.floats(0, 800), st.floats(-np.pi, np.pi), st.floats(0, 0.5))
def test_the_papers_check_by_grab_width_cannot_fail(m, theta, any_beta):
    """Section 4.6 compares α̂ with ψ, for arcsin(m·b/(x·l)) is the ray's angle; |ψ − α̂| ≤ β̂ for any β̂ whatever."""
    alpha = np.arccos(np.clip(eq2_cos_alpha(m, theta, any_beta, 1644.82), -1, 1))
    assert abs(np.arctan2(m, 1644.82) - alpha) <= any_beta + 1e-7

"""The report stands alone and says what the numbers say."""

import csv
import re

import pytest
from stress_runs import small

from simgrab.lab.stress import laboratory
from simgrab.lab.stress.laboratory import REPORT, SUMMARY
from simgrab.lab.stress.page import extreme, sentences


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("stress")
    charted = [(law, 100.0, b, s) for law in ("rayleigh", "bursts") for b in (0.0, 5.0) for s in (2.0, 8.0)]
    studies = [
        small("lean-along", (0.0,), (1.2,), replications=10, n=300),
        small("alpha-exponential", replications=4, n=200),
        small("edge", replications=3, n=100),
        small("convergence", *charted, replications=3),
    ]
    progress = []
    findings = laboratory.run(studies, out, progress=lambda done, total: progress.append((done, total)))
    return out, findings, progress


def test_the_page_needs_no_other_file(run):
    page = (run[0] / REPORT).read_text(encoding="utf-8")
    assert page.count("<svg") == 1 + 1 + 3 + 1
    assert not re.search(r"""(src|href)\s*=\s*["'](?!\#|data:)""", page.replace("xlink:href", "href"))
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert "Assumption × estimator" in page


def test_its_sentences_hold_the_summarys_numbers(run):
    out, findings, _ = run
    page = (out / REPORT).read_text(encoding="utf-8")
    figure = findings[0].summary.at((1.2,), "zero-tilt", "beta_error_deg")
    assert figure.mean == pytest.approx(-5)
    study = findings[0].summary.study
    said = sentences(findings[0].summary, study.points)
    assert all(line in page for line in said)
    worst, name, point = extreme(findings[0].summary, study.points, "beta_error_deg", lambda f: abs(f.mean))
    assert point == (1.2,)
    assert name != "zero-tilt"
    assert f"bias of β̂: at worst {worst.mean:.4g} ± {worst.mean_se:.2g}° ({name}, lean-along = 1.2 deg)" in said[0]
    assert "records refused: at worst 100 ± 0 % (paper-iteration" in page


def test_the_summary_is_what_the_figures_are(run):
    out, findings, _ = run
    with (out / "lean-along" / SUMMARY).open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    row = next(
        r for r in rows
        if (r["lean-along"], r["estimator"], r["quantity"]) == ("1.2", "mean-ray", "beta_error_deg")
    )  # fmt: skip
    figure = findings[0].summary.at((1.2,), "mean-ray", "beta_error_deg")
    assert (int(row["count"]), float(row["mean"]), float(row["mean_se"])) == pytest.approx(
        (10, figure.mean, figure.mean_se)
    )
    assert figure.mean == pytest.approx(-1.2, abs=5 * figure.mean_se + 0.02)


def test_progress_ends_with_all_replications(run):
    assert run[2][0][0] == 0
    assert run[2][-1] == (2 * 10 + 4 * 4 + 6 * 3 + 8 * 3,) * 2

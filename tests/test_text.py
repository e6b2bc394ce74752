"""Names that others chose are shown as text wherever they come: they run nothing, steer nothing and break no line."""

import contextlib
import csv
import html
import html.parser
import io
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from markdown_it import MarkdownIt
from rich.console import Console
from rich.table import Table

from simgrab import cli, text
from simgrab.dataset.datasets import DatasetIdentity
from simgrab.errors import MOST_CHARACTERS, SimgrabError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.detect import pictures as detections
from simgrab.instrument.run import page as run_page
from simgrab.instrument.run import runs
from simgrab.instrument.run.run import measure
from simgrab.judge.check.report import Report, as_junit
from simgrab.judge.check.verdicts import Verdict
from simgrab.model.calibration import Calibration
from simgrab.model.records.observations import Detection
from simgrab.reports import html as pages
from simgrab.reports import terminal

CAMERA = Calibration(64, 36, 60.0, 32.0, 18.0)
HOSTILE = {
    "markup": "<script>alert(1)</script><img src=x onerror='alert(2)'>\"&amp;</title></style>",
    "controls": "a\x1b[31mred\r\n\x07\x00\x9b\u202eltr\u2028",
    "rich": "[red]x[/red][/nothing] [link=file:///etc]y[/]",
    "formula": "=cmd()|'/c calc'!A1",
    "surrogates": "\udcff\udcfe.png",
    "Markdown": "`x` | <b>y</b> | [z](http://a) $\\frac$",
    "long": "x" * 100_000,
}
every = pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)


class Elements(html.parser.HTMLParser):
    """Gathers elements with the names of their attributes, and text."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.found, self.text = [], ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, tuple(name for name, _ in attributes)))

    def handle_data(self, data):
        self.text += data


def shows(page, plain, name):
    """Whether a page has the elements of one with a plain name, and shows the name as text."""
    page.encode("utf-8")
    assert Elements(page).found == Elements(plain).found
    assert text.printable(name) in Elements(page).text
    assert not any(c in page for c in "\x1b\x07\x00\x9b\u202e\u2028")


PAGE = """
{% extends "base.html" %}{% from "parts.html" import photograph, table %}
{% block title %}{{ name }}{% endblock %}{% block lead %}{{ name }}{% endblock %}
{% block content %}<h2>{{ name }}</h2>{{ table(name, [name], [[name]]) }}{{ photograph(jpeg, name) }}{% endblock %}
"""


@every
def test_pages_show_names_as_text(name):
    def page(name):
        return pages.ENVIRONMENT.from_string(PAGE).render(name=name, jpeg=b"")

    shows(page(name), page("plain"), name)


class Named:
    """An instrument that calls itself and its reasons anything."""

    def __init__(self, name):
        self.name = name

    def __call__(self, frames, calibration):  # noqa: ARG002
        return [Measurement(status="missed", reason=self.name) for _ in frames]


def run_of(name):
    frames = [Frame(np.zeros((36, 64, 3), np.uint8), None, name=name) for _ in range(2)]
    return measure(frames, CAMERA, Named(name), source=name)


def test_a_run_shows_and_keeps_names_as_text(tmp_path):
    name = "".join(HOSTILE[kind] for kind in ("formula", "markup", "controls", "rich", "surrogates", "Markdown"))
    found = run_of(name)
    shows(run_page.page(found, {}), run_page.page(run_of("plain"), {}), name)
    runs.save(found, tmp_path)
    assert pq.read_table(tmp_path / runs.TABLE)["file"].to_pylist() == [text.encodable(name)] * 2
    with (tmp_path / runs.SHEET).open(encoding="utf-8", newline="") as file:
        csv.field_size_limit(10**6)
        for row in csv.DictReader(file):
            assert row["file"].startswith("'=")
            assert row["reason"].startswith("'=")
            assert row["file"].isprintable()
    again = runs.load(tmp_path)
    assert (again.instrument, again.source) == (text.encodable(name),) * 2


@every
def test_a_table_of_detections_holds_any_name(name, tmp_path):
    watched = detections.Detections("x", (Path(name),), (Detection("none", name, 0.0),), (0.1,))
    for ending in (".csv", ".parquet"):
        detections.save(watched, tmp_path / f"found{ending}")
    assert pq.read_table(tmp_path / "found.parquet")["reason"].to_pylist() == [name] or name == HOSTILE["surrogates"]
    with (tmp_path / "found.csv").open(encoding="utf-8", newline="") as file:
        csv.field_size_limit(10**6)
        (row,) = csv.DictReader(file)
    assert not row["file"].startswith("=")
    assert row["file"].removeprefix("'") == text.printable(Path(name))


@every
def test_the_terminal_shows_names_as_text(name):
    table, out = Table("a"), io.StringIO()
    table.add_row(terminal.cell(name))
    Console(file=out, width=200_000, color_system="standard", force_terminal=True).print(table)
    assert text.printable(name) in out.getvalue()
    assert "\x1b[31m" not in out.getvalue()


@every
def test_errors_are_one_line_whatever_they_name(name, capsys):
    def fails(**_):
        raise SimgrabError(f"cannot read {name}")

    with pytest.raises(SystemExit) as ended:
        cli.main(fails)
    assert ended.value.code == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert len(printed) <= len("simgrab: \n") + MOST_CHARACTERS
    if len(name) < MOST_CHARACTERS // 2:
        assert printed == f"simgrab: cannot read {text.printable(name)}\n"


@every
def test_cards_show_names_as_text(name):
    card_of_nets = pytest.importorskip("simgrab.training.card")
    Card, markdown = card_of_nets.Card, card_of_nets.markdown

    def lines_of(name):
        card = Card(
            name="find", task="Finds.", data=(DatasetIdentity(name, "d1", "d2", 0, 800),), examples=640, recipe={},
            epochs=3, seconds=90.0, metrics={"recall": 0.9, "by_weather": {name: {name: 1.0}}},
        )  # fmt: skip
        return markdown(card.of(b"weights")).splitlines()

    lines, plain = lines_of(name), lines_of("plain")
    assert len(lines) == len(plain)
    for line, other in zip(lines, plain, strict=True):
        assert line.replace("\\|", "").count("|") == other.count("|") or "frames of `" in line
        assert "<b>" not in line.replace("\\<", "") or "frames of `" in line
    assert not any("\x1b" in line for line in lines)


@pytest.mark.parametrize("name", [*HOSTILE.values(), "https://evil.example", "(ftp://a.b/c) WWW.evil.example www.a.b"])
def test_markdown_shows_names_as_text(name):
    line = text.markdown(name)
    assert not re.search(r"(https?|ftp)://|www\.", line, re.IGNORECASE)  # GitHub Flavored Markdown, 6.9: autolinks
    shown = MarkdownIt("commonmark").renderInline(line)
    assert html.unescape(shown) == html.unescape(text.printable(name))
    assert "<" not in shown


@every
def test_reports_for_servers_hold_any_name(name):
    verdict = Verdict(scene=name, what=name, status="failed", message=name)
    report = Report(suite="mine", instrument=name, seed=0, general=(verdict,))
    (case,) = ElementTree.fromstring(as_junit(report)).iter("testcase")
    assert case.get("name") == "".join(c if c.isprintable() else " " for c in name)


def test_a_study_shows_its_words_as_text(tmp_path, monkeypatch):
    pytest.importorskip("simgrab.lab")
    from simgrab.lab.stress import catalogue, laboratory
    from simgrab.lab.stress import page as stress_page

    monkeypatch.setattr(stress_page, "svg", lambda *_: "<svg></svg>")  # whose drawing takes long
    # Nor are processes what is tested.
    here = contextlib.nullcontext()
    here.map = lambda work, items, name: map(work, items)  # noqa: ARG005
    monkeypatch.setattr(laboratory, "worker_pool", lambda *_: here)

    def page(words):
        study = catalogue.read({
            "name": "mine", "title": words, "axes": [{"axis": "sigma", "values": [1.0]}], "estimators": ["mean-ray"],
            "n": 20, "replications": 2,
            "accept": [{"at": [1.0], "estimator": "mean-ray", "quantity": "refused", "high": 1.0, "says": words}],
        })  # fmt: skip
        folder = tmp_path / str(len(words))
        laboratory.run([study], folder)
        return (folder / laboratory.REPORT).read_text()

    words = HOSTILE["markup"] + HOSTILE["controls"] + HOSTILE["Markdown"]
    shows(page(words), page("plain"), words)

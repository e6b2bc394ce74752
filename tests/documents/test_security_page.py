"""SECURITY.md names tests and limits that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_test_that_is_named_exists():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    named = re.findall(r"`?(tests/[\w/]+\.py)::(\w+)", text)
    assert len(named) >= 20
    for file, test in named:
        assert re.search(rf"^def {test}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), f"{file}::{test}"


def test_every_limit_that_is_named_exists_and_has_its_value():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    limits = re.findall(r"`simgrab\.([\w.]+)\.([A-Z_]+)` = ([\d.]+)", text)
    assert len(limits) >= 5
    for module, constant, value in limits:
        found = __import__(f"simgrab.{module}", fromlist=[constant])
        assert float(getattr(found, constant)) == float(value), f"{module}.{constant}"

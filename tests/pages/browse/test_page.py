"""The page of `simgrab browse` in a real browser: what a user sees and does, and that names are text."""

import json
import shutil

import numpy as np
import pytest
from browser import NAMELESS, needs_chromium

import simgrab
from scripts.chromium import page
from simgrab.pages.browse import browse

pytestmark = [pytest.mark.slow, needs_chromium]
HOSTILE = "<img src=x onerror=document.title=1><script>document.title=2<b>"


@pytest.fixture(scope="module")
def data(split_dataset, tmp_path_factory):
    return shutil.copytree(split_dataset, tmp_path_factory.mktemp("page") / HOSTILE)


@pytest.fixture(scope="module")
def address(data):
    with browse.serving(browse.open(data)) as address:
        yield address


@pytest.fixture(scope="module")
def chromium():
    with page() as shown:
        yield shown


@pytest.fixture
def shown(chromium, address):
    chromium.console.clear()
    chromium.look(1440, 900)
    chromium.open(address.url)
    chromium.wait('document.body?.dataset.ready === "yes" && document.querySelectorAll("#grid li").length === 12')
    yield chromium
    assert chromium.console == []


def wait_for_frames(shown, numbers):
    """Wait until the grid shows these frames, in this order."""
    on_the_grid = '[...document.querySelectorAll("#grid [data-row]")].map((one) => one.dataset.row).join()'
    shown.wait(f'{on_the_grid} === "{",".join(map(str, numbers))}"')


def set_range(shown, column, low, high):
    shown.evaluate(f"""(() => {{
      const fields = document.querySelectorAll('section[data-column="{column}"] input');
      [fields[0].value, fields[1].value] = ["{low}", "{high}"];
      fields[0].dispatchEvent(new Event("input"));
    }})()""")
    shown.wait(f'location.hash.includes("{column}=")')


def test_the_token_leaves_the_address(shown, address):
    assert address.token not in shown.evaluate("location.href")
    assert shown.evaluate("document.cookie") == ""  # no script reads it


def test_names_are_text(shown, data):
    assert shown.evaluate('document.getElementById("name").textContent') == str(data)
    assert shown.evaluate("document.title") == f"{data} – simgrab"
    assert shown.evaluate('document.querySelectorAll("h1 *, script:not([src])").length') == 0


def test_the_browser_refuses_markup_and_code(shown):
    for act in ('document.body.innerHTML = "<i>"', 'eval("1")', 'new Function("1")'):
        refused = f"(() => {{ try {{ {act}; return false; }} catch {{ return true; }} }})()"
        found = shown.call("Runtime.evaluate", expression=refused, allowUnsafeEvalBlockedByCSP=False)
        assert found["result"]["value"], act
    refused = shown.evaluate("fetch('https://example.org').then(() => false, () => true)")
    assert refused
    assert len(shown.console) >= 2  # of which the browser complains
    shown.console.clear()


def test_filters_work_on_each_other(shown, data):
    rows = simgrab.open(data).rows
    alpha = np.array([row.alpha_deg for row in rows])
    rope = np.array([row.rope_length_m for row in rows])
    low, high = np.quantile(alpha, 0.3), np.quantile(rope, 0.7)
    set_range(shown, "alpha_deg", low, "")
    set_range(shown, "rope_length_m", "", high)
    left = np.flatnonzero((alpha >= low) & (rope <= high))
    wait_for_frames(shown, left)
    assert shown.evaluate('document.getElementById("count").textContent') == f"{len(left)} of 12 frames"
    sums = shown.evaluate(
        '[...document.querySelectorAll("#panels svg[role=img]")].map((one) => one.getAttribute("aria-label"))'
    )
    counted = {text.split()[2]: int(text.split()[-2]) for text in sums}
    assert counted["alpha_deg"] == (rope <= high).sum()  # its own filter does not count
    assert counted["rope_length_m"] == (alpha >= low).sum()
    assert counted["distance_m"] == len(left)
    shown.evaluate('document.getElementById("clear").click()')
    shown.wait('document.querySelectorAll("#grid li").length === 12')


def test_rows_are_sorted_by_any_column(shown, data):
    rope = [row.rope_length_m for row in simgrab.open(data).rows]
    shown.evaluate("""(() => {
      const sort = document.getElementById("sort");
      sort.value = "rope_length_m";
      sort.dispatchEvent(new Event("change"));
      document.getElementById("direction").click();
    })()""")
    shown.wait('location.hash.includes("sort=-rope_length_m")')
    wait_for_frames(shown, np.argsort(rope)[::-1])


def test_a_frame_opens_with_everything_that_is_known(shown, data):
    row = simgrab.open(data).rows[3]
    shown.evaluate('document.querySelector("#grid [data-row=\\"3\\"]").click()')
    shown.wait('document.querySelector("#detail[open] img")?.naturalWidth > 0')
    cells = shown.evaluate("""Object.fromEntries([...document.querySelectorAll("#detail tbody tr")]
      .map((one) => [one.children[0].textContent, one.children[1].textContent]))""")
    assert set(row.__struct_fields__) <= set(cells)
    assert float(cells["alpha_deg"]) == pytest.approx(row.alpha_deg, rel=1e-8)
    shown.evaluate(
        'document.querySelector("#detail").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }))'
    )
    shown.wait('document.getElementById("detail-title").textContent === "Frame 4"')
    shown.evaluate('document.getElementById("detail-close").click()')


def test_a_selection_is_exported(shown, tmp_path):
    out = json.dumps(str(tmp_path / "out"))
    shown.evaluate('[2, 5].forEach((i) => document.querySelectorAll("#grid input")[i].click())')
    shown.evaluate('document.getElementById("export").click()')
    shown.evaluate(f'document.getElementById("out").value = {out}; document.getElementById("export-start").click()')
    shown.wait('document.getElementById("export-status").textContent.startsWith("Written: 2 frames")')
    assert [frame.truth.frame for frame in simgrab.open(tmp_path / "out")] == [2, 5]


@pytest.mark.parametrize("width", [1440, 1024, 390])
def test_the_page_fits_and_every_control_has_a_name(shown, width):
    shown.look(width, 800, dark=width == 1024)
    assert not shown.evaluate("document.documentElement.scrollWidth > innerWidth")
    assert shown.evaluate(NAMELESS) == []

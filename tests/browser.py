"""Open a page in a real headless Chromium, and ask what it shows."""

import pytest

from scripts import chromium

needs_chromium = pytest.mark.skipif(chromium.COMMAND is None, reason="no Chromium")

NAMELESS = """[...document.querySelectorAll("button, select, input")].filter((one) =>
  !(one.getAttribute("aria-label") || one.labels?.[0]?.textContent.trim() || one.textContent.trim())
).map((one) => one.outerHTML)"""
"""Controls without a name for screen readers."""

# What a reader sees: each figure with its size, whether the page fits a window and a phone, what screen readers lack.
_PROBE = """(() => {
  %s
  const figures = [...document.querySelectorAll("figure svg, figure img")].map((e) => {
    const box = e.getBoundingClientRect();
    return { kind: e.tagName.toLowerCase(), whole: e.tagName !== "IMG" || e.naturalWidth > 0,
      size: [box.width, box.height], texts: e.querySelectorAll("text, g[id*=text]").length };
  });
  // As on a phone: what is wider than the window scrolls by itself.
  document.body.style.width = "340px";
  const right = document.body.getBoundingClientRect().right + 1;
  const phone = [...document.querySelectorAll("main *")]
    .filter((e) => !e.closest(".wide, script") && e.getBoundingClientRect().right > right)
    .map((e) => e.outerHTML.slice(0, 80));
  document.body.style.width = "";
  const unnamed = [...document.querySelectorAll("svg:not([role=img][aria-label]), img:not([alt]), th:not([scope])")]
    .map((e) => e.outerHTML.slice(0, 80));
  return { figures, phone, unnamed, wide: document.documentElement.scrollWidth > innerWidth,
    extra: typeof extra === "undefined" ? null : extra };
})()"""


def shown(text, folder, script=""):
    """Figures of a page, whether it is wider than the window, and what ``script`` leaves in ``extra``.

    An error on the console fails.
    """
    path = folder / "page.html"
    path.write_text(text, encoding="utf-8")
    with chromium.page() as page:
        page.look(1100, 900)
        page.open(path.as_uri())
        page.wait('location.protocol === "file:" && document.readyState === "complete"')
        found = page.evaluate(_PROBE % script)
        assert page.console == []
    for figure in found["figures"]:
        assert figure["whole"]
        assert figure["size"][0] > 300
        assert figure["size"][1] > 80
        assert figure["kind"] == "img" or figure["texts"] > 4
    assert not found["wide"]
    assert found["phone"] == []
    assert found["unnamed"] == []
    return found

"""Time `simgrab browse` in headless Chromium, on a dataset of many rows.

python -m scripts.make_large_dataset runs/quay-day runs/large
python -m scripts.bench_browse runs/large [--json FILE]
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import psutil

from scripts.chromium import Page, page

REPEATS = 5
_READY = 'document.body?.dataset.ready === "yes"'
_IMAGES = '[...document.querySelectorAll("#grid img")].slice(0, 8).every((image) => image.complete)'
# Set a filter as a user does, and give ms until the grid holds the rows that pass and the browser has painted them.
_FILTER = """(async () => {
  const input = document.querySelector('section[data-column="%s"] input[type=number]');
  const before = document.getElementById("count").textContent;
  const grid = document.getElementById("grid");
  const start = performance.now();
  const changed = new Promise((done) => new MutationObserver((_, own) => { own.disconnect(); done(); })
    .observe(grid, { childList: true }));
  input.value = "%s";
  input.dispatchEvent(new Event("input"));
  await changed;
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const ms = performance.now() - start;
  if (document.getElementById("count").textContent === before) throw new Error("the filter changed nothing");
  return ms;
})()"""
_PAINT = 'performance.getEntriesByName("first-contentful-paint")[0]?.startTime'


@contextlib.contextmanager
def browsing(path: Path) -> Iterator[tuple[str, psutil.Process, float]]:
    """Start the command; gives its address, its process, and the seconds until it printed the address."""
    begun = time.perf_counter()
    command = [sys.executable, "-m", "simgrab", "browse", str(path), "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        yield line.split()[-1], psutil.Process(process.pid), time.perf_counter() - begun
        process.terminate()


def measured(shown: Page, url: str) -> dict[str, float]:
    """Open the page once, and filter it."""
    shown.open("about:blank")
    begun = time.perf_counter()
    shown.open(url)
    shown.wait('document.querySelectorAll("#grid li").length > 0')
    grid_s = time.perf_counter() - begun
    shown.wait(f"{_READY} && {_IMAGES}")
    found = {
        "first contentful paint, s": shown.evaluate(_PAINT) / 1000,
        "first frames on the grid, s": grid_s,
        "images and histograms, s": time.perf_counter() - begun,
    }
    for number, (column, value) in enumerate((("alpha_deg", 2.0), ("rope_length_m", 15.0), ("visible_fraction", 0.5))):
        found[f"filter {number + 1} ({column}), ms"] = shown.evaluate(_FILTER % (column, value))
    found["memory of the page's process, MB"] = max(_renderers()) / 1e6
    return found


def _renderers() -> Iterator[int]:
    """Resident memory of Chromium's processes that show pages, bytes."""
    for child in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "--type=renderer" in child.cmdline():
                yield child.memory_info().rss


def _most_bytes(process: psutil.Process) -> int:
    """Largest resident memory that a process had, bytes."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


@click.command()
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("--json", "file", type=click.Path(path_type=Path), help="Keep all samples.")
def main(dataset: Path, file: Path | None) -> None:
    """Measure, and print medians."""
    samples: list[dict[str, float]] = []
    with browsing(dataset) as (url, process, started_s), page() as shown:
        shown.look(1440, 900)
        for _ in range(REPEATS):
            samples.append(measured(shown, url))
            samples[-1]["command's memory, MB"] = process.memory_info().rss / 1e6
        shown.evaluate('document.querySelector("[data-layer=mask]").click()')
        shown.wait('document.querySelectorAll("#grid path.mask").length > 0')
        for _ in range(20):
            shown.evaluate('document.getElementById("next").click()')
            time.sleep(0.3)
        most = _most_bytes(process)
    print(f"{dataset}: {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; median (largest) of {REPEATS}")
    print(f"command until its address is printed, s: {started_s:.2f}")
    for name in samples[0]:
        values = [sample[name] for sample in samples]
        print(f"{name}: {statistics.median(values):.3g} ({max(values):.3g})")
    print(f"command's largest memory, with masks and 20 further pages, MB: {most / 1e6:.0f}")
    if file is not None:
        file.write_text(json.dumps({"started_s": started_s, "most_bytes": most, "samples": samples}), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Time `simgrab studio` in headless Chromium on `quay-day` at 960 x 540 px.

python -m scripts.bench_studio [--json FILE]

A slider is moved as a user does; a time goes from its event until the browser has painted the small frame. The CPU time
of a small frame, on all threads, is measured without a browser: it does not depend on what else the machine does.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click

from scripts.chromium import Page, page
from simgrab import scenes
from simgrab.studio.rendering import Rendering, Wish

OPENED, MOVED = 5, 12
KEYS = (
    "swing.alpha.sigma_deg",
    "camera.beta_deg",
    "camera.roll_deg",
    "weather.visibility_m",
    "light.sun_elevation_deg",
)
CHANGED = 8
START = {
    "swing.alpha.sigma_deg": 3.0,
    "camera.beta_deg": 3.0,
    "weather.visibility_m": 200.0,
    "light.sun_elevation_deg": 40.0,
}
_READY = 'document.body?.dataset.ready === "yes"'
_FULL = 'document.querySelector("[data-side=a]").dataset.small === "false"'
# Move a key's slider by a step, and give ms until the small frame is painted, and then until the full one is.
_MOVE = """(async () => {
  const row = [...document.querySelectorAll("[data-key]")].find((one) => one.dataset.key === "%s");
  const slider = row.querySelector("input[type=range]");
  const view = document.querySelector("[data-side=a]");
  const drawn = (small) => new Promise((done) => {
    const observer = new MutationObserver(() => {
      if (view.dataset.small !== String(small)) return;
      observer.disconnect();
      requestAnimationFrame(() => setTimeout(() => done(performance.now() - start)));
    });
    observer.observe(view, { attributeFilter: ["data-drawn"] });
  });
  const start = performance.now();
  const [small, full] = [drawn(true), drawn(false)];
  slider.value = Number(slider.value) + %d;
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  return [await small, await full];
})()"""
_SET = """(() => {
  const row = [...document.querySelectorAll("[data-key]")].find((one) => one.dataset.key === "%s");
  row.querySelector("input[role=switch]").click();
})()"""


def opened(shown: Page, url: str) -> tuple[float, float]:
    """Open the page; gives seconds until the first frame is painted, and until the full one is."""
    shown.open("about:blank")
    begun = time.perf_counter()
    shown.open(url)
    shown.wait(_READY)
    first = time.perf_counter() - begun
    shown.wait(_FULL)
    return first, time.perf_counter() - begun


def moved(shown: Page, key: str) -> list[tuple[float, float]]:
    """Move a key's slider to and fro; the first time does not count."""
    found = []
    for number in range(MOVED + 1):
        small, full = shown.evaluate(_MOVE % (key, 3 if number % 2 else 4))
        found.append((small, full))
    return found[1:]


def costs() -> dict[str, list[float]]:
    """Measure the CPU time that a small frame takes after each key has changed, ms."""
    found: dict[str, list[float]] = {}
    rendering = Rendering()
    for key, value in START.items():
        for step in range(CHANGED + 1):
            scenario = scenes.load("quay-day", {key: value * (1 + 0.02 * step)}, size=(960, 540))
            begun = time.process_time()
            rendering.picture("a", Wish(scenario, 0, small=True)).result()
            if step:  # the first goes on from another key
                found.setdefault(key, []).append(1000 * (time.process_time() - begun))
    rendering.end()
    return found


@click.command()
@click.option("--json", "file", type=click.Path(path_type=Path), help="Keep all samples.")
def main(file: Path | None) -> None:
    """Measure, and print medians with the smallest and largest."""
    samples = {f"{key}: CPU time of a small frame, ms": values for key, values in costs().items()}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.toml").write_text(scenes.load("quay-day", size=(960, 540)).to_toml(), encoding="utf-8")
        begun = time.perf_counter()
        command = [sys.executable, "-m", "simgrab", "studio", "scene.toml", "--no-open"]
        with (
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder
            ) as process,
            page() as shown,
        ):
            assert process.stdout is not None
            url = process.stdout.readline().split()[-1]
            samples["command until its address is printed, s"] = [time.perf_counter() - begun]
            shown.look(1440, 900)
            times = [opened(shown, url) for _ in range(OPENED)]
            samples["first frame after the page opens, s"] = [first for first, _ in times]
            samples["full frame after the page opens, s"] = [full for _, full in times]
            for key in KEYS:
                if key == "weather.visibility_m":
                    shown.evaluate(_SET % key)
                    time.sleep(3)
                pairs = moved(shown, key)
                samples[f"{key}: small frame, ms"] = [small for small, _ in pairs]
                samples[f"{key}: full frame, {300} ms of rest included, ms"] = [full for _, full in pairs]
            process.terminate()
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    print(f"{os.cpu_count()} cores, load {load}; median (smallest to largest)")
    for name, values in samples.items():
        print(f"{name}: {statistics.median(values):.3g} ({min(values):.3g} to {max(values):.3g})")
    if file is not None:
        file.write_text(json.dumps(samples), encoding="utf-8")


if __name__ == "__main__":
    main()

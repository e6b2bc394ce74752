"""Draw docs/rooms.svg: the rooms of the package, and what each may import, as the test of imports has it.

scripts/python -m scripts.make_rooms
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

OUT = Path(__file__).parents[1] / "docs" / "rooms.svg"
INK, TRUTH, BLIND, PLAIN = "#1f2933", "#e6d3a8", "#bcd9e6", "#e4e7eb"

# Left, bottom, width, height, name, what lives there, colour.
ROOMS = [
    (0.0, 8.6, 2.85, 0.95, "training", "detector · reader", TRUTH),
    (3.05, 8.6, 2.85, 0.95, "lab", "stress · paper · bench", TRUTH),
    (6.1, 8.6, 2.85, 0.95, "pages", "browse · studio", TRUTH),
    (9.15, 8.6, 2.85, 0.95, "match", "footage → scene", TRUTH),
    (0.0, 7.2, 12.0, 0.95, "cli", "one file per command, no logic", PLAIN),
    (0.0, 5.8, 12.0, 0.95, "judge", "audit · evaluate · check · doctor", TRUTH),
    (0.0, 4.4, 7.0, 0.95, "dataset", "writes, reads and exports datasets, videos, shards", TRUTH),
    (0.0, 2.65, 7.0, 1.3, "world", "trajectory → projection → camera → label\n"
     "scenery: places, grab, jib head · sensors", TRUTH),
    (7.4, 2.65, 4.6, 2.7, "instrument", "source · detect · read\nestimate · alarm · run\n"
     "never sees labels or scenes", BLIND),
    (0.0, 1.4, 7.0, 0.95, "model: scenario · scenes · truth", "what can be set, and what is known of a frame", TRUTH),
    (0.0, -0.25, 12.0, 1.35, "ground floor", "model: geometry · rng · records · calibration · layouts   reports\n"
     "io: files of every kind   runtime: processes   errors · text", PLAIN),
]  # fmt: skip
# From the importing room to the imported one.
ARROWS = [
    *(((x, 8.6), (x, 8.15)) for x in (1.4, 4.5, 7.5, 10.6)), ((3.0, 7.2), (3.0, 6.75)), ((3.0, 5.8), (3.0, 5.35)),
    ((9.7, 5.8), (9.7, 5.35)), ((3.0, 4.4), (3.0, 3.95)), ((3.0, 2.65), (3.0, 2.35)), ((3.0, 1.4), (3.0, 1.1)),
    ((9.7, 2.65), (9.7, 1.1)),
]  # fmt: skip


def main() -> None:
    """Draw and save."""
    mpl.rcParams["svg.hashsalt"] = "simgrab"
    figure = Figure(figsize=(9, 7.1))
    axes: Axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-0.2, 12.2)
    axes.set_ylim(-0.4, 9.75)
    axes.axis("off")
    for x, y, width, height, name, text, colour in ROOMS:
        axes.add_patch(
            FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0,rounding_size=0.12", fc=colour, ec=INK, lw=1)
        )
        lines = text.count("\n") + 1
        axes.text(x + 0.2, y + height - 0.33, name, weight="bold", size=13, color=INK, va="center")
        axes.text(x + 0.2, y + height - 0.55 - 0.15 * lines, text, size=9.5, color=INK, va="center", linespacing=1.5)
    for start, end in ARROWS:
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2})
    figure.savefig(OUT, metadata={"Date": None})


if __name__ == "__main__":
    main()

"""Draw docs/rooms.svg: the rooms of the package, and what each may import, as the test of imports has it.

python -m scripts.make_rooms
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
    (0.0, 7.2, 12.0, 0.95, "cli", "one file per command, no logic", PLAIN),
    (0.0, 5.8, 5.2, 0.95, "judge", "audit · evaluate · check · stress · paper", TRUTH),
    (5.6, 5.8, 2.7, 0.95, "browse · studio", "pages", TRUTH),
    (8.7, 5.8, 3.3, 0.95, "training", "detector · reader", TRUTH),
    (0.0, 3.6, 6.6, 1.75, "world", "trajectory → projection → camera → label\n"
     "scenery: places, grab, jib head\nframes · output: datasets, videos", TRUTH),
    (7.0, 3.6, 5.0, 1.75, "instrument", "detect · read · estimate\nalarm · pipeline · run\n"
     "never sees labels or scenes", BLIND),
    (0.0, 2.2, 3.1, 0.95, "labels", "truth, datasets", TRUTH),
    (3.5, 2.2, 3.1, 0.95, "scenario · scenes", "what can be set", TRUTH),
    (0.0, 0.0, 12.0, 1.75, "ground floor", "pages: tables, figures, HTML, server\n"
     "records · calibration · layouts · distributions\ngeometry · utilities · rng · errors · text", PLAIN),
]  # fmt: skip
# From the importing room to the imported one.
ARROWS = [
    ((2.6, 7.2), (2.6, 6.75)), ((6.95, 7.2), (6.95, 6.75)), ((10.3, 7.2), (10.3, 6.75)),
    ((2.6, 5.8), (2.6, 5.35)), ((5.0, 5.8), (7.3, 5.35)), ((5.6, 6.28), (5.2, 6.28)), ((6.2, 5.8), (5.9, 5.35)),
    ((7.8, 5.8), (7.8, 5.35)), ((9.0, 5.8), (6.5, 5.35)), ((10.5, 5.8), (10.5, 5.35)),
    ((1.5, 3.6), (1.5, 3.15)), ((5.0, 3.6), (5.0, 3.15)), ((1.5, 2.2), (1.5, 1.75)), ((5.0, 2.2), (5.0, 1.75)),
    ((9.5, 3.6), (9.5, 1.75)),
]  # fmt: skip


def main() -> None:
    """Draw and save."""
    mpl.rcParams["svg.hashsalt"] = "simgrab"
    figure = Figure(figsize=(9, 6.1))
    axes: Axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-0.2, 12.2)
    axes.set_ylim(-0.2, 8.35)
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

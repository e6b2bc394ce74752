"""Compare MuJoCo and both second renderers of `simgrab audit` on the silhouettes of a scene's frames.

    uv run python -m scripts.second_renderers [SCENE] [--frames 64] [--set KEY=VALUE ...]

Prints the worst edge, IoU and centroid of each pair, and the time that each renderer takes for a silhouette. Exits with
1 where edges of a pair are more than one sample apart, its IoU or centroid is worse than the bounds below, or no frame
shows the grab.
"""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from itertools import combinations

import click

from simgrab.cli import main as run
from simgrab.judge.audit.second_renderer import RENDERERS
from simgrab.judge.audit.silhouettes import NONE, Difference, grab_shapes, samples_a_pixel, silhouette
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

MUJOCO = "MuJoCo"
LEAST_IOU, MOST_CENTROID_PX = 0.9995, 0.005  # an edge may fall on either side of a sample


@dataclass
class Comparison:
    """Worst differences by pair of renderers, and seconds by renderer."""

    frames: int = 0
    within: bool = True
    apart: dict[tuple[str, str], Difference] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def agrees(self) -> bool:
        """Whether there was something to compare, and every pair was within the bounds."""
        return self.frames > 0 and self.within


def compare(generator: FrameGenerator, frames: range) -> Comparison:
    """Render the silhouettes of all frames that show the grab with MuJoCo and with both second renderers."""
    found = Comparison()
    with ExitStack() as stack:
        others = [stack.enter_context(closing(kind())) for kind in RENDERERS]
        for frame in frames:
            row = generator.frame(frame).truth
            if row.in_frame_fraction == 0:
                continue
            for other in others:
                other.load(grab_shapes(generator, frame))
            scene, projection = generator.scene(frame), generator.project(frame)
            renderer, grab = scene.renderer, scene.world.plan.grab
            window = projection.window
            samples = samples_a_pixel(window)
            start, masks = time.perf_counter(), {MUJOCO: renderer.silhouette(projection.moment, window, samples)}
            lap = time.perf_counter()
            found.seconds[MUJOCO] = found.seconds.get(MUJOCO, 0.0) + lap - start
            for other in others:
                start, masks[other.name] = lap, silhouette(other, grab, row, window, samples)
                lap = time.perf_counter()
                found.seconds[other.name] = found.seconds.get(other.name, 0.0) + lap - start
            bound = Difference(1 / samples + 1e-6, LEAST_IOU, MOST_CENTROID_PX)
            for a, b in combinations(masks, 2):
                apart = Difference.of(masks[a], masks[b], window)
                found.apart[a, b] = found.apart.get((a, b), NONE).worst(apart)
                found.within &= apart.worst(bound) == bound
            found.frames += 1
    return found


@click.command()
@click.argument("scene", default="quay-day")
@click.option("--frames", default=64, show_default=True, type=click.IntRange(min=1))
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any key.")
def command(scene: str, frames: int, assignments: tuple[str, ...]) -> None:
    """Compare the renderers on a scene's first frames."""
    scenario = scenes.load(scene, scenes.parse_changes(assignments) | {"frames": frames})
    with FrameGenerator(scenario) as generator:
        found = compare(generator, range(frames))
    click.echo(f"{found.frames} frames of {scenario.name}")
    for (a, b), apart in found.apart.items():
        click.echo(f"{a} and {b}: {apart.edge_px:.3f} px, IoU {apart.iou:.6f}, centroid {apart.centroid_px:.5f} px")
    for name, seconds in found.seconds.items():
        click.echo(f"{name}: {seconds / max(found.frames, 1):.2f} s a silhouette")
    sys.exit(0 if found.agrees else 1)


if __name__ == "__main__":
    run(command)

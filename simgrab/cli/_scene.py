"""Options that name a scenario, shared by verbs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from simgrab.cli._options import together
from simgrab.errors import ScenarioError

if TYPE_CHECKING:
    from simgrab.model.scenario import Scenario

SHORT_NAMES = {
    "beta": "camera.beta_deg", "sigma": "swing.alpha.sigma_deg", "frames": "frames", "seed": "seed",
    "yolo": "labels.yolo",
}  # fmt: skip


# SCENE and what changes it.
scene_options = together(
    click.argument("scene", default="quay-day"),
    click.option("--beta", type=float, help="Camera tilt β, degrees."),
    click.option("--sigma", type=float, help="Swing: √E[α²], degrees."),
    click.option("--frames", type=int, help="Number of frames."),
    click.option("--seed", type=int, help="Random seed."),
    click.option("--size", metavar="WxH", help="Size of the image, e.g. 640x360; keys in pixels scale with it."),
    click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="KEY=VALUE",
        help="Set any key, each once, e.g. camera.roll_deg=3; --beta and similar options take precedence.",
    ),
)
# Functions of the user's, which installed packages offer as entry points.
extension_options = together(
    click.option(
        "--randomiser", metavar="NAME", help="Changes keys clip by clip; an entry point of simgrab.randomisers."
    ),
    click.option("--trajectory", metavar="NAME", help="Replaces the swing; an entry point of simgrab.trajectories."),
    click.option(
        "--effect",
        "effects",
        metavar="NAME",
        multiple=True,
        help="Image effect of simgrab.effects; may be repeated.",
    ),
)


def load_scene(scene: str, assignments: tuple[str, ...], size: str | None, **short: float | str | None) -> Scenario:
    """Read the scene that the options describe; short options override ``--set``, and ``--size`` is applied last."""
    from simgrab.model import scenes
    from simgrab.model.scenario import Dynamic

    wanted = None if size is None else scenes.parse_size(size)
    changes = scenes.parse_changes(assignments)
    sigma = short.pop("sigma", None)
    changes |= {SHORT_NAMES[name]: value for name, value in short.items() if value is not None}
    scenario = scenes.load(scene, changes)
    if sigma is not None:
        if isinstance(scenario.swing, Dynamic):
            raise ScenarioError(
                "swing.alpha.sigma_deg", "--sigma applies to independent frames; this scene simulates the swing"
            )
        scenario = scenes.load(scene, changes | {SHORT_NAMES["sigma"]: sigma})
    return scenario if wanted is None else scenes.resized(scenario, *wanted)

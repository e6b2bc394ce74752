"""``simgrab scenes``."""

from __future__ import annotations

import json

import click

from simgrab.cli._scene import load_scene, scene_options


class _Scenes(click.Group):
    """Takes the name of a scene for `show` of it."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        return super().resolve_command(ctx, args if args[0] in self.commands else ["show", *args])


@click.group(name="scenes", cls=_Scenes, invoke_without_command=True)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.pass_context
def command(ctx: click.Context, as_json: bool) -> None:
    """List the bundled scenes; show one resolved, or the JSON schema of scene files."""
    if ctx.invoked_subcommand:
        return
    from simgrab.model import scenes

    described = {name: scenes.load(name).description for name in scenes.names()}
    if as_json:
        click.echo(json.dumps(described))
        return
    width = max(map(len, described))
    for name, text in described.items():
        click.echo(f"{name:<{width}}  {text}")


@command.command()
@scene_options
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def show(
    scene: str, beta: float | None, sigma: float | None, frames: int | None, seed: int | None, size: str | None,
    assignments: tuple[str, ...], as_json: bool,
) -> None:  # fmt: skip
    """Print SCENE with every default filled in, as a scene file of its own."""
    data = load_scene(scene, assignments, size, beta=beta, sigma=sigma, frames=frames, seed=seed)
    click.echo(json.dumps(data.to_dict(), indent=1) if as_json else data.to_toml())


@command.command()
def schema() -> None:
    """Print the JSON schema of scene files, for editors."""
    from simgrab.model import scenario

    click.echo(json.dumps(scenario.schema(), indent=2))

"""``simgrab doctor``."""

from __future__ import annotations

import dataclasses
import json
import sys

import click


@click.command(name="doctor")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def command(as_json: bool) -> None:
    """Say whether this machine can draw, and with what. Exit status: 0 yes, 1 no."""
    from simgrab.judge.doctor import examine

    found = examine()
    if as_json:
        renderer = (
            dataclasses.asdict(found.renderer) | {"fingerprint": found.renderer.digest} if found.renderer else None
        )
        click.echo(json.dumps(dataclasses.asdict(found) | {"renderer": renderer}))
    else:
        click.echo(f"backend          {found.backend}")
        if found.renderer:
            click.echo(f"GL_RENDERER      {found.renderer.renderer}")
            click.echo(f"GL_VERSION       {found.renderer.version}")
            click.echo(f"fingerprint      {found.renderer.digest}")
        else:
            click.echo(f"cannot draw: {found.problem}")
        second = found.second_renderer or f"none, audits stay incomplete: {found.second_problem}"
        click.echo(f"second renderer  {second}")
        for package, version in found.versions.items():
            click.echo(f"{package:<24} {version}")
    sys.exit(0 if found.healthy else 1)

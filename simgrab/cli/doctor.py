"""``simgrab doctor``."""

from __future__ import annotations

import dataclasses
import json
import sys

import click


@click.command(name="doctor")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def command(as_json: bool) -> None:
    """Report whether this machine can render, with what, and what the bytes of a dataset depend on.

    Exit status: 0 if it can, 1 if not.
    """
    from simgrab.judge.doctor import examine
    from simgrab.runtime.versions import PACKAGES

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
            click.echo(f"renderer SHA-256 {found.renderer.digest}")
        else:
            click.echo(f"cannot render: {found.problem}")
        second = found.second_renderer or f"none, audits stay incomplete: {found.second_problem}"
        click.echo(f"second renderer  {second}")
        click.echo("The bytes of a dataset depend on the renderer, on what these take from the CPU and on versions:")
        if found.rasterizer:
            mesa = found.rasterizer
            click.echo(f"Mesa             {mesa.mesa}, LLVM {mesa.llvm}, vectors of {mesa.vector_bits} bits")
        for library, features in found.cpu_features.items():
            click.echo(f"{library + ' uses':<16} {' '.join(features) or 'nothing beyond its baseline'}")
        deciding = ("simgrab", *PACKAGES)
        for package in deciding:
            click.echo(f"{package:<24} {found.versions[package]}")
        click.echo("Also installed:")
        for package, version in found.versions.items():
            if package not in deciding:
                click.echo(f"{package:<24} {version}")
    sys.exit(0 if found.renderer else 1)

"""``simgrab cluster``."""

from __future__ import annotations

import signal
from contextlib import suppress

import click

from simgrab.text import printable


@click.group(name="cluster")
def command() -> None:
    """Try a Ray cluster on this machine; clusters of several machines are started with `ray start`."""


@command.command(name="up")
@click.option("--local", "nodes", type=click.IntRange(1, 64), required=True, help="Nodes to start on this machine.")
def up(nodes: int) -> None:
    """Start a cluster of LOCAL nodes that share this machine's cores; Ctrl-C ends it."""
    from simgrab.runtime import machine
    from simgrab.runtime.cluster import local_cluster

    cores = max(1, machine.cores() // nodes)
    with local_cluster(nodes, cores) as address:
        click.echo(printable(f"Ray cluster at {address}: {nodes} nodes with {cores} cores each"))
        click.echo(printable(f"in another terminal: simgrab render SCENE --cluster {address}"))
        with suppress(KeyboardInterrupt):
            signal.pause()

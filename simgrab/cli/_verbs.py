"""The commands by name, each with its module and its line in the list. Only the module that is run is imported."""

from __future__ import annotations

import importlib
from importlib.util import find_spec

import click

VERBS = {
    "audit": ("simgrab.cli.audit:command", "Check the labels of a dataset."),
    "bench": ("simgrab.lab.cli.bench:command", "Compare methods on the clips of SwingBench."),
    "browse": ("simgrab.pages.cli.browse:command", "Look through a dataset or a run in the browser."),
    "check": ("simgrab.cli.check:command", "Compare an instrument's measurements with limits and a baseline."),
    "cluster": ("simgrab.cli.cluster:command", "Try a Ray cluster on this machine."),
    "detect": ("simgrab.cli.detect:command", "Detect the grab in images or a dataset."),
    "doctor": ("simgrab.cli.doctor:command", "Report whether this machine can render, and with what."),
    "estimate": ("simgrab.cli.estimate:command", "Estimate camera tilt and swing angles from grab centres."),
    "evaluate": ("simgrab.cli.evaluate:command", "Compare a run with the truth."),
    "export": ("simgrab.cli.export:command", "Write a dataset in the layout of another tool."),
    "grab": ("simgrab.cli.grab:command", "Check or convert the 3-D model of your own grab."),
    "match": ("simgrab.match.cli.match:command", "Write a scene that looks like a camera's footage."),
    "new": ("simgrab.match.cli.new:command", "Write a scene from what you know of your camera, crane and grab."),
    "paper": ("simgrab.lab.cli.paper:command", "Repeat the simulation study of the paper."),
    "render": ("simgrab.cli.render:command", "Render a dataset of labelled frames, or a video."),
    "run": ("simgrab.cli.run:command", "Measure swing in a video, a stream, images or a dataset."),
    "scenes": ("simgrab.cli.scenes:command", "List the bundled scenes, or show one."),
    "stress": ("simgrab.lab.cli.stress:command", "Violate an assumption and measure every estimator."),
    "studio": ("simgrab.pages.cli.studio:command", "Edit a scene in the browser."),
    "train": ("simgrab.training.cli.train:command", "Train the instrument's networks."),
}
"""A command is left out where its room, the package ``simgrab.ROOM`` of its module, is not installed."""


class Verbs(click.Group):
    """A group whose commands are those of `VERBS`."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return [name for name, (where, _) in VERBS.items() if find_spec(".".join(where.split(".")[:2])) is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        module, _, name = VERBS[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, VERBS[name][1]) for name in self.list_commands(ctx)])

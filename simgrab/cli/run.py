"""`simgrab run`: from a video to angles and alarms."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

from simgrab.cli._options import NEW_FOLDER, PATH, EstimatorName, FiniteRange, detector_option, imu_option, plc_option
from simgrab.instrument.contract import Instrument
from simgrab.io.parse import shown
from simgrab.text import printable

MOST_RATE_HZ = 1000.0
LONGEST_S = 86_400.0


def _stretch(_context: click.Context, _option: click.Parameter, text: str | None) -> float | None:
    """Read a stretch of time, s: ``300s``, ``300`` or ``5min``."""
    if text is None:
        return None
    matched = re.fullmatch(r"(\d+(?:\.\d+)?)(s|min|)", text.strip())
    seconds = 0.0 if matched is None else float(matched[1]) * (60 if matched[2] == "min" else 1)
    if not 0 < seconds <= LONGEST_S:
        raise click.BadParameter(f"{shown(text)}: invalid duration; use e.g. 300s or 5min, at most one day")
    return seconds


def _report(line: str) -> None:
    """Print what happens during a live run."""
    click.echo(printable(line), err=True)


@click.command(name="run")
@click.argument("source")
@click.option("--camera", type=PATH, help="Camera TOML.  [default: beside or in SOURCE, or that of match]")
@click.option("--out", type=NEW_FOLDER, help="New folder for the results.  [default: runs/SOURCE-run]")
@detector_option
@click.option("--instrument", help="A pipeline of your own, as package.module:factory, in place of simgrab's.")
@click.option(
    "--estimator",
    type=EstimatorName(),
    help="[default: rope-aware; with --plc of slewing or luffing pendulum-smoother; without a rope length mean-ray]",
)
@click.option(
    "--calibrate",
    callback=_stretch,
    help="Estimate the tilt from the first part, e.g. 300s, or all of a shorter record.  [default: the whole record]",
)
@click.option("--calibration", type=PATH, help="Use the tilt of another run: its tilt.toml.")
@imu_option
@plc_option
@click.option("--live", is_flag=True, help="Update the estimate while frames arrive; always on for streams.")
@click.option(
    "--rate",
    type=FiniteRange(0, MOST_RATE_HZ, min_open=True),
    help="Frames/s of a folder, or of a video without time stamps.  [default: what the video states, or 9]",
)
@click.option(
    "--wind-m-s",
    type=FiniteRange(0, 40),
    default=0.0,
    help="Mean wind: the grab leans in it, and intervals get wider.  [default: the controller's, or not known]",
)
@click.option("--no-video", is_flag=True, help="Write no annotated video.")
@click.option("--paper", is_flag=True, help="Print and report the paper's figures of its own video too.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("--quiet", is_flag=True, help="Print errors only.")
def command(
    source: str, camera: Path | None, out: Path | None, detector_name: str, instrument: str | None,
    estimator: str | None, calibrate: float | None, calibration: Path | None, imu: Path | None, plc: Path | None,
    live: bool, rate: float | None, wind_m_s: float, no_video: bool, paper: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Measure swing in SOURCE: a video, a stream's URL, a folder of images, or a dataset.

    A live run prints faults as they are found, and begins a new folder OUT-2, OUT-3, ... every hour.

    OUT gets angles.parquet and .csv, alarms.json, tilt.toml, run.json, annotated.mp4 and report.html. Exit status: 0 at
    least one frame has an angle, 1 none has (the reason is in OUT), 2 bad input.
    """
    import json

    from simgrab.cli._progress import bar
    from simgrab.instrument.detect import BUNDLED
    from simgrab.instrument.pipeline import assemble
    from simgrab.instrument.run.run import RunOptions, run
    from simgrab.instrument.run.runs import alarms
    from simgrab.instrument.run.subject import open_instrument
    from simgrab.instrument.run.table import HEAD, beside_paper, held, measured
    from simgrab.instrument.source import plain_name
    from simgrab.reports.terminal import cell, stdout, table

    out = out or Path("runs") / f"{plain_name(source)}-run"
    chosen: Instrument
    if instrument is not None:
        if detector_name != BUNDLED or any((estimator, calibrate, calibration, imu, plc, live)):
            raise click.UsageError(
                "--instrument cannot be combined with --detector, --estimator, --calibrate, --calibration, --imu, "
                "--plc or --live."
            )
        sys.path.insert(0, str(Path.cwd()))  # a pipeline lies where one works
        chosen = open_instrument(instrument)
    else:
        chosen = assemble(
            detector=detector_name, estimator=estimator, calibrate_s=calibrate, tilt=calibration, live=live, imu=imu,
            plc=plc, follow="://" in source, wind_m_s=wind_m_s,
        )  # fmt: skip
    options = RunOptions(live=live, video=not no_video, rate_hz=rate, paper=paper)
    with bar("measuring", shown=not (quiet or as_json)) as progress:
        found = run(source, camera, out, chosen, options, progress, None if quiet else _report)
    if as_json:
        facts = {"failure": found.failure, "alarms": alarms(found.events), "out": str(out)}
        click.echo(json.dumps(found.about | facts))
    elif not quiet:
        console = stdout()
        console.print(table([*held(found), *(row for row in measured(found) if row[1])]))
        if paper:
            console.print(table(beside_paper(found), HEAD))
        console.print(f"report: {cell(out / 'report.html')}", soft_wrap=True)
    if found.failure is not None:
        click.echo(printable(f"simgrab: {found.failure}"), err=True)
        sys.exit(1)

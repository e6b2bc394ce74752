"""`simgrab estimate`: tilt and swing from a file of pixels."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from simgrab.cli._options import PATH, EstimatorName, imu_option, plc_option
from simgrab.instrument.estimate import DEFAULT
from simgrab.text import printable


@click.command()
@click.argument("file", type=PATH)
@click.option("--camera", type=PATH, required=True, help="Camera TOML.")
@click.option(
    "--estimator",
    type=EstimatorName(),
    help=f"[default: {DEFAULT}; with --plc as run; with --imu pendulum-smoother]",
)
@imu_option
@plc_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with every frame, instead of the table.")
def command(file: Path, camera: Path, estimator: str | None, imu: Path | None, plc: Path | None, as_json: bool) -> None:
    """Estimate camera tilt and swing angles from grab centres.

    FILE is CSV or parquet with columns u_px, v_px[, u_sd_px, v_sd_px, rope_length_m, time_s]: the grab centre in the
    image as recorded (empty where it was not detected), its standard deviations, |OA| in metres, and seconds. A run's
    angles.csv and a dataset's labels.parquet work as well: the first two columns may be called grab_u_px, grab_v_px.

    Exit status: 0 estimated, 1 refused, 2 bad input.
    """
    from simgrab.instrument.estimate import measure as judge

    if imu is not None and estimator is not None:
        raise click.UsageError("--imu selects its own estimator; leave out --estimator.")
    measured = judge.measure(file, camera, estimator, imu=imu, plc=plc)
    if as_json:
        click.echo(json.dumps(judge.as_json(measured), indent=1))
    else:
        from simgrab.instrument.estimate.table import show

        show(measured.estimate)
    for warning in measured.warnings:
        click.echo(printable(f"warning: {warning}"), err=True)
    if not measured.estimate.ok:
        sys.exit(1)

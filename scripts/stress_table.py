"""Print the key figures of a finished laboratory in Markdown: ``scripts/python -m scripts.stress_table FOLDER``.

FOLDER is what ``simgrab stress --all --out FOLDER`` made. Of each study: the error of α̂ at a true 10° in the worst
direction, mean over replications, at the worst value of its axes.
"""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.lab.stress import catalogue, laboratory
from simgrab.lab.stress.page import axes, cell


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True))
def main(folder: Path) -> None:
    """Print the table."""
    studies = [catalogue.load(name) for name in catalogue.names() if (folder / name / laboratory.TRIALS).exists()]
    everything = [laboratory.read(folder / study.name, study) for study in studies]
    found = [finding for finding in everything if finding.summary.study.kind == "estimators"]
    names = list(dict.fromkeys(name for f in found for name in f.summary.study.estimators))
    print(f"| study | {' | '.join(names)} |")
    print("|---|" + "---|" * len(names))
    for finding in found:
        cells = " | ".join(cell(finding.summary, name)[0] for name in names)
        study = finding.summary.study
        print(f"| `{study.name}`: {axes(study).removeprefix(f'{study.name} ')} | {cells} |")
    limits = [verdict for finding in everything for verdict in finding.verdicts]
    print(f"\n{sum(v.passed for v in limits)} of {len(limits)} limits are met")


if __name__ == "__main__":
    main()

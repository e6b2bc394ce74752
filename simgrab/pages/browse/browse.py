"""Open a folder and serve the page over it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from simgrab.errors import DatasetError, RunError
from simgrab.instrument.run import runs
from simgrab.io.parse import is_dir, is_file
from simgrab.pages.browse import dataset, run
from simgrab.pages.browse.subject import Subject
from simgrab.pages.server import local
from simgrab.pages.server.local import Address


def open(path: str | Path, source: str | Path | None = None) -> Subject:
    """Open a dataset or a run to browse it.

    Parameters
    ----------
    path : str or Path
        Folder of `simgrab render` or `simgrab run`.
    source : str or Path, optional
        What a run measured: a dataset, a video or a folder of pictures.

    Raises
    ------
    SimgrabError
        If it is neither, or cannot be read.
    """
    path = Path(path)
    if not is_dir(path, DatasetError):
        what = "it is a file, not the folder" if is_file(path, DatasetError) else "there is no such folder"
        raise DatasetError(f"{path}: {what} of a dataset or run")
    if is_file(path / runs.TABLE, RunError):
        return run.open(path, None if source is None else Path(source))
    if source is not None:
        raise RunError(f"{path}: --source is for the folder of simgrab run, which has {runs.TABLE}")
    return dataset.open(path)


@contextlib.contextmanager
def serving(subject: Subject, port: int = 0) -> Iterator[Address]:
    """Serve the page over a subject until the context is left; an export that is running then leaves nothing behind.

    Raises `ServerError` if the extra ``studio`` is not installed, or the port cannot be used.
    """
    local.check_installed()
    from simgrab.pages.browse.app import Browser

    browser = Browser(subject)
    with local.serving(browser.app, port) as address:
        try:
            yield address
        finally:
            browser.exports.end()

"""One error base. Its messages are for the person who reads them: what was wrong, where, and what would be right."""

from __future__ import annotations

import errno
from pathlib import Path

from simgrab.text import printable

MOST_CHARACTERS = 1000  # of a message
_LEFT_OUT = " … "


class SimgrabError(Exception):
    """Anything a user can put right. The command line prints the message alone and exits with status 2.

    The message is one line of at most `MOST_CHARACTERS`, whatever names and values it quotes: what a terminal would not
    show as it is stands as an escape sequence, and the middle of a longer one is left out.
    """

    def __str__(self) -> str:
        return shortened(printable(self._message()))

    def _message(self) -> str:
        return super().__str__()


class InvalidError(SimgrabError, ValueError):
    """Values of a scenario, a file or a struct that do not fit: their types, their ranges, or each other."""


class ScenarioError(InvalidError):
    """A scenario that cannot be: an unknown key, a value out of range, a contradiction.

    Parameters
    ----------
    key : str
        Dotted key of the offending value, e.g. ``camera.beta_deg``; empty where the file as a whole is meant.
    problem : str
        What is wrong, and what would be right.
    """

    def __init__(self, key: str, problem: str) -> None:
        super().__init__(key, problem)
        self.key, self.problem = key, problem

    def _message(self) -> str:
        return f"{self.key}: {self.problem}" if self.key else self.problem


class CalibrationError(InvalidError):
    """A camera file that cannot be read or describes no camera."""


class LayoutError(InvalidError):
    """A digit layout that is not there, cannot be, or does not fit the picture."""


class DatasetError(SimgrabError):
    """A dataset folder that cannot be written, read, resumed or trusted."""


class PictureError(DatasetError):
    """A picture file that is none, is cut off or damaged, or is too large: ``path`` and ``reason``."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(path, reason)
        self.path, self.reason = path, reason

    def _message(self) -> str:
        return f"{self.path} cannot be read as an image: {self.reason}"


class RendererError(SimgrabError):
    """No usable offscreen OpenGL, or a picture that was not rendered whole."""


class RecordError(SimgrabError):
    """A record of pixels, rope lengths and times that no estimator can use. Names the row or the column."""


class TrainingError(SimgrabError):
    """A training that cannot start, go on or fit into memory."""


class DetectorError(SimgrabError):
    """A file that is not a detector, or a picture that no detector can use."""


class ReaderError(SimgrabError):
    """A file that is no reader of digits, or a picture that none can read."""


class SourceError(SimgrabError):
    """A video, stream, folder or dataset that gives no pictures, or none that the camera file describes."""


class RunError(InvalidError):
    """A run or an evaluation that cannot be: settings that exclude each other, a folder in the way, files that lack."""


class SuiteError(InvalidError):
    """A suite of checks, or its baseline, that cannot be read or makes no sense. Names file and key."""


class InstrumentError(SimgrabError):
    """A pipeline under test that cannot be imported, made or called, or that does not keep to the contract."""


class StressError(InvalidError):
    """A study that cannot be, an estimator that cannot be used, or a folder that cannot be written or taken up."""


class BenchError(InvalidError):
    """A season, an entry or a score file of SwingBench that cannot be read, or does not keep to the format."""


class ServerError(SimgrabError):
    """A page that cannot be served: a missing extra, or a port that is taken."""


class ExtensionError(SimgrabError):
    """A user's own randomiser, trajectory or effect that is not found, raises, or returns what no frame can be."""


class WorkerError(SimgrabError):
    """A piece of work of which its worker process dies again and again. Names the frame, clip or part."""


class ClusterError(SimgrabError):
    """A cluster that cannot be reached, or whose machines have other versions than this one."""


def memory_problem(problem: BaseException | None) -> str | None:
    """Return the message of an out-of-memory error of any library; None of another error."""
    while problem is not None:
        text, code = str(problem), getattr(problem, "errno", None)
        if isinstance(problem, MemoryError) or code == errno.ENOMEM or any(sign in text for sign in _WANT_OF_MEMORY):
            return first_line(problem) if text else "allocation failed"
        problem = problem.__cause__ or problem.__context__
    return None


_WANT_OF_MEMORY = (
    "Insufficient memory",  # OpenCV
    "Failed to allocate",  # OpenCV, onnxruntime
    "bad_alloc",  # C++
    "pthread_create",  # onnxruntime's threads
    "can't start new thread",  # whose stack found no room
    "Cannot allocate memory",  # the system, to whom loads a library or starts a process
    "failed to map segment",  # a library, where memory is limited
    "could not allocate",  # MuJoCo, case apart
    "Could not allocate",
)


def shortened(line: str) -> str:
    """Leave out the middle of what is longer than `MOST_CHARACTERS`."""
    half = (MOST_CHARACTERS - len(_LEFT_OUT)) // 2
    return line if len(line) <= MOST_CHARACTERS else line[:half] + _LEFT_OUT + line[-half:]


def first_line(problem: BaseException) -> str:
    """Shorten the message of another library's error to one line of at most 160 characters."""
    text = str(getattr(problem, "strerror", None) or problem).strip()
    return one_line((text or type(problem).__name__).splitlines()[0])


def one_line(text: object, most: int = 160) -> str:
    """Quote text of a file in one line of so many characters at most."""
    return printable(str(text)[:most])[:most]

"""One error base. Its messages are for the person who reads them: what was wrong, where, and what would be right."""

from __future__ import annotations


class SimgrabError(Exception):
    """Anything a user can put right. The command line prints the message alone and exits with status 2."""


class ScenarioError(SimgrabError):
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

    def __str__(self) -> str:
        return f"{self.key}: {self.problem}" if self.key else self.problem


class CalibrationError(SimgrabError):
    """A camera file that cannot be read or describes no camera."""


class LayoutError(SimgrabError):
    """A digit layout that is not there, cannot be, or does not fit the picture."""


class DatasetError(SimgrabError):
    """A dataset folder that cannot be written, read, resumed or trusted."""


class RendererError(SimgrabError):
    """No usable offscreen OpenGL, or a picture that the renderer did not draw whole."""


class RecordError(SimgrabError):
    """A record of pixels, rope lengths and times that no estimator can use. Names the row or the column."""


class TrainingError(SimgrabError):
    """A training that cannot start, go on or fit into memory."""


class DetectorError(SimgrabError):
    """A file that is no detector, or a picture that none can look at."""


class ReaderError(SimgrabError):
    """A file that is no reader of digits, or a picture that none can read."""


class SourceError(SimgrabError):
    """A video, stream, folder or dataset that gives no pictures, or none that the camera file describes."""


class RunError(SimgrabError):
    """A run or an evaluation that cannot be: settings that exclude each other, a folder in the way, files that lack."""


class SuiteError(SimgrabError):
    """A suite of checks, or its baseline, that cannot be read or makes no sense. Names file and key."""


class InstrumentError(SimgrabError):
    """A pipeline under test that cannot be imported, made or called, or that does not keep to the contract."""


class StressError(SimgrabError):
    """A study that cannot be, an estimator that cannot be used, or a folder that cannot be written or taken up."""


def first_line(problem: BaseException) -> str:
    """Say in one line, of 160 characters at most, what an error of another library says."""
    text = str(getattr(problem, "strerror", None) or problem).strip()
    return (text or type(problem).__name__).splitlines()[0][:160]

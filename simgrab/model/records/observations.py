"""Results of detectors and readers for one picture."""

from __future__ import annotations

from dataclasses import dataclass

from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Detection:
    """Result of a detector for one picture, or why it found nothing. Pixels: (0, 0) is the corner of the top-left one.

    Attributes
    ----------
    status : str
        ``"found"`` or ``"none"``.
    reason : str
        Why there is no detection; empty if found.
    score : float
        From 0 to 1; the best candidate's score if none was good enough, 0 without candidates.
    box : ndarray, shape (4,), or None
        x0, y0, x1, y1 of the visible grab, within the picture; None unless found.
    centre : ndarray, shape (2,), or None
        Position of the grab centre A in the picture, which is not the centre of the box; None if not output.
    yaw : float or None
        Direction of the grab's x axis in the picture at A, clockwise from the picture's x axis, rad, in [0, π): the
        grab looks the same after half a turn. None where it is not determined, as mostly of orange-peel grabs.
    box_sd_px : ndarray, shape (4,), or None
    centre_sd_px : ndarray, shape (2,), or None
    yaw_sd : float or None
        Standard deviations; ±1.96 of them are meant to cover 95 %.
    """

    status: str
    reason: str
    score: float
    box: Array | None = None
    centre: Array | None = None
    yaw: float | None = None
    box_sd_px: Array | None = None
    centre_sd_px: Array | None = None
    yaw_sd: float | None = None

    @property
    def found(self) -> bool:
        """Whether there is a grab."""
        return self.status == "found"


@dataclass(frozen=True)
class Reading:
    """Result of reading the rope lengths on the display in one picture, or why it was refused.

    Attributes
    ----------
    status : str
        ``"read"`` or ``"refused"``.
    reason : str
        Reason of a refusal; empty when read.
    hoist_text, closing_text : str
        As the display writes them, with ``?`` for a digit that was refused.
    hoist_m : float or None
        Length of the hoist rope on the display; None when refused.
    """

    status: str
    reason: str
    hoist_text: str
    closing_text: str
    hoist_m: float | None

    @property
    def text(self) -> str:
        """Both numbers, as in the label column ``rope_text``."""
        return f"{self.hoist_text} {self.closing_text}"

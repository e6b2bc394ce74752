"""What comes out: pictures, clips, the display in them, detection labels, splits."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

import msgspec

from simgrab.model import layouts
from simgrab.model.layouts import Layout
from simgrab.model.scenario.base import Share, Strict, about
from simgrab.model.scenario.font import BundledFont, Font

YoloLabels = Literal["box", "pose", "seg", "obb"]


class Image(Strict, frozen=True):
    """How frames are drawn and stored."""

    format: Annotated[Literal["jpeg", "png"], about("File format of the images.")] = "jpeg"
    quality: Annotated[int, about("JPEG quality.", ge=1, le=100)] = 95
    samples: Annotated[Literal[0, 2, 4, 8], about("Samples per pixel for antialiasing; 0 is none.")] = 4
    shadow_map_px: Annotated[Literal[0, 1024, 2048, 4096, 8192], about("Side of the shadow map; 0: none.")] = 4096
    ids: Annotated[bool, about("Whether to store what each pixel shows.")] = False
    depth: Annotated[bool, about("Whether to store the depth of each pixel.")] = False

    @property
    def stores_buffers(self) -> bool:
        """Whether ids or depth of the whole picture are stored."""
        return self.ids or self.depth


class Shutter(Strict, frozen=True):
    """When the rows of a picture see the scene: each for ``exposure_s``, the last ``rolling_s`` after the first.

    The middle row's mid-exposure falls on the frame's instant. Labels, ``time_s`` among them, are those of the instant
    at which the row exposes that shows the grab centre. Independent frames stand still.
    """

    exposure_s: Annotated[float, about("Exposure time of each row.", ge=0, le=0.5)] = 0.0
    rolling_s: Annotated[float, about("Time from the first row's exposure to the last row's.", ge=0, le=0.1)] = 0.0

    @property
    def open_s(self) -> float:
        """From the first row's beginning to the last row's end."""
        return self.exposure_s + self.rolling_s


class Clip(Strict, frozen=True):
    """Time and the video: how frames follow each other, and what coding and network do to them.

    Each clip has a motion of its own, and the camera takes its frame k at k / ``frame_rate_hz``. Frames that are
    repeated come too late to be coded: the picture last sent is sent again in their place. No time stamp overtakes the
    one before, and the first frame of a clip is always sent, at time 0. The bit rate is kept but for a buffer of two
    seconds.
    """

    frame_rate_hz: Annotated[float, about("Frames per second.", ge=0.01, le=120)] = 9.0
    clip_frames: Annotated[int, about("Frames of a clip; 0 makes all frames one clip.", ge=0, le=10_000_000)] = 0
    bit_rate_mbit_s: Annotated[float, about("Bit rate of the video.", gt=0, le=200)] = 4.0
    gop_frames: Annotated[int, about("Frames from one key frame to the next.", ge=1, le=1000)] = 50
    drop_share: Annotated[float, about("Share of frames that are lost and leave a gap.", ge=0, le=0.9)] = 0.0
    repeat_share: Annotated[float, about("Share of the others that repeat the previous image.", ge=0, le=0.9)] = 0.0
    jitter_ms: Annotated[float, about("Standard deviation of the time stamps.", ge=0, le=1000)] = 0.0

    def count(self, frames: int) -> int:
        """Return the number of clips that so many frames make."""
        return math.ceil(frames / (self.clip_frames or frames))

    def of(self, frame: int) -> int:
        """Return the clip that a frame is of."""
        return frame // self.clip_frames if self.clip_frames else 0

    def span(self, clip: int, frames: int) -> range:
        """Frames of one clip, in order; the last clip may be shorter."""
        length = self.clip_frames or frames
        return range(clip * length, min((clip + 1) * length, frames))


class Display(Strict, frozen=True):
    """The on-screen display: clock, and the rope lengths as the crane's controller knows them.

    The lengths shown are |OA|, and that plus what the closing rope pays out to open the jaws, each less ``constant_m``.
    """

    layout: Annotated[str | Layout, about("Name of a bundled layout, a layout's own table, or none.")] = "none"
    start: Annotated[str, about("Local date and time of the clock at time 0.")] = "2022-01-26T14:05:37"
    lag_s: Annotated[float, about("How old the displayed lengths are.", ge=0, le=10)] = 0.5
    refresh_hz: Annotated[float, about("Refresh rate of the lengths.", gt=0, le=100)] = 5.0
    readout_s: Annotated[float, about("Time to read out the image; a refresh tears the display.", ge=0, le=100)] = 0.03
    constant_m: Annotated[float, about("How much too short the displayed lengths are.", ge=-10, le=10)] = 2.5
    font: Annotated[Font, about("Font of the rope lengths; the clock keeps the bundled one.")] = BundledFont()

    def check(self) -> None:  # noqa: D102
        if isinstance(self.layout, str) and self.layout not in ("none", *layouts.names()):
            raise ValueError(
                f"layout must be one of: none, {', '.join(layouts.names())}, or a layout's table; got {self.layout!r}"
            )
        try:
            local = self.started.tzinfo is None
        except ValueError:
            local = False
        if not local:
            raise ValueError(f"start must be a local date and time such as 2022-01-26T14:05:37, got {self.start!r}")
        if self.readout_s * self.refresh_hz > 1:
            raise ValueError(
                f"readout_s must not exceed the {1 / self.refresh_hz:g} s between refreshes: "
                "an image can be torn only once"
            )

    @property
    def started(self) -> datetime:
        """Date and time when time begins."""
        return datetime.fromisoformat(self.start)

    def layout_in(self, width_px: int, height_px: int) -> Layout | None:
        """Fit the layout to a picture, None where nothing is shown; raises `LayoutError` where that is too small."""
        if self.layout == "none":
            return None
        layout = layouts.load(self.layout) if isinstance(self.layout, str) else self.layout
        return layout.scaled(width_px, height_px)


class Labels(Strict, frozen=True):
    """Detection labels: of frames that show at least this fraction of the grab's silhouette."""

    least_visible_fraction: Annotated[Share, about("Least visible fraction of the grab for a detection box.")] = 0.1
    yolo: Annotated[YoloLabels, about("YOLO labels: boxes, key points, polygons of masks, or oriented boxes.")] = "box"


class Splits(Strict, frozen=True):
    """Shares of the seeded draw into train, val and test."""

    train: Annotated[Share, about("Share of the training split.")] = 0.8
    val: Annotated[Share, about("Share of the validation split.")] = 0.1
    test: Annotated[Share, about("Share of the test split. The three sum to 1.")] = 0.1

    def check(self) -> None:  # noqa: D102
        if not math.isclose(self.train + self.val + self.test, 1.0, abs_tol=1e-9):
            raise ValueError(f"train + val + test must be 1, got {self.train + self.val + self.test:g}")

    @property
    def shares(self) -> dict[str, float]:
        """By the name of each split that is to have frames, its share."""
        return {name: share for name, share in msgspec.structs.asdict(self).items() if share > 0}

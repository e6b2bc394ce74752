"""What comes out: pictures, clips, the display in them, detection labels, splits."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

from simgrab.model import layouts
from simgrab.model.layouts import Layout
from simgrab.model.scenario.base import Meta, Share, Strict
from simgrab.model.scenario.font import BundledFont, Font


class Image(Strict, frozen=True):
    """How frames are drawn and stored."""

    format: Literal["jpeg", "png"] = "jpeg"
    quality: Annotated[int, Meta(ge=1, le=100)] = 95
    samples: Literal[0, 2, 4, 8] = 4
    shadow_map_px: Literal[0, 1024, 2048, 4096, 8192] = 4096
    ids: bool = False
    depth: bool = False

    @property
    def stores_buffers(self) -> bool:
        """Whether ids or depth of the whole picture are stored."""
        return self.ids or self.depth


class Shutter(Strict, frozen=True):
    """When the rows of a picture see the scene: each for ``exposure_s``, the last ``rolling_s`` after the first.

    The middle row's mid-exposure falls on the frame's instant. Labels, ``time_s`` among them, are those of the instant
    at which the row exposes that shows the grab centre. Independent frames stand still.
    """

    exposure_s: Annotated[float, Meta(ge=0, le=0.5)] = 0.0
    rolling_s: Annotated[float, Meta(ge=0, le=0.1)] = 0.0

    @property
    def open_s(self) -> float:
        """From the first row's beginning to the last row's end."""
        return self.exposure_s + self.rolling_s


class Clip(Strict, frozen=True):
    """Time and the video: how frames follow each other, and what coding and network do to them.

    A scenario's ``frames`` are cut into clips of ``clip_frames``, each with a motion of its own; 0 makes it one. The
    camera takes frame k of a clip at k / ``frame_rate_hz``. A share ``drop_share`` of the frames is lost and leaves a
    gap. Of the others a share ``repeat_share`` comes too late to be coded: the picture last sent is sent again in its
    place. ``jitter_ms`` is the standard deviation of the time stamps, of which none overtakes the one before. The first
    frame of a clip is always sent, at time 0. ``bit_rate_mbit_s`` is kept but for a buffer of two seconds; every
    ``gop_frames`` pictures begin with a key frame.
    """

    frame_rate_hz: Annotated[float, Meta(ge=0.01, le=120)] = 9.0
    clip_frames: Annotated[int, Meta(ge=0, le=10_000_000)] = 0
    bit_rate_mbit_s: Annotated[float, Meta(gt=0, le=200)] = 4.0
    gop_frames: Annotated[int, Meta(ge=1, le=1000)] = 50
    drop_share: Annotated[float, Meta(ge=0, le=0.9)] = 0.0
    repeat_share: Annotated[float, Meta(ge=0, le=0.9)] = 0.0
    jitter_ms: Annotated[float, Meta(ge=0, le=1000)] = 0.0

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

    ``layout`` is a bundled layout's name or a layout's own table; "none" shows nothing. The controller refreshes the
    numbers ``refresh_hz`` times a second with values ``lag_s`` old; the picture is read out over ``readout_s``, and a
    refresh that falls in between tears it. The lengths shown are |OA|, and that plus what the closing rope pays out to
    open the jaws, each less ``constant_m``. The clock shows ``start`` when time begins. ``font`` is that of the
    lengths; the clock keeps the bundled one.
    """

    layout: str | Layout = "none"
    start: str = "2022-01-26T14:05:37"
    lag_s: Annotated[float, Meta(ge=0, le=10)] = 0.5
    refresh_hz: Annotated[float, Meta(gt=0, le=100)] = 5.0
    readout_s: Annotated[float, Meta(ge=0, le=100)] = 0.03
    constant_m: Annotated[float, Meta(ge=-10, le=10)] = 2.5
    font: Font = BundledFont()

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
    """Which frames get a detection box: those that show at least this fraction of the grab's silhouette."""

    least_visible_fraction: Share = 0.1


class Splits(Strict, frozen=True):
    """Shares of the seeded draw into train, val and test."""

    train: Share = 0.8
    val: Share = 0.1
    test: Share = 0.1

    def check(self) -> None:  # noqa: D102
        if not math.isclose(self.train + self.val + self.test, 1.0, abs_tol=1e-9):
            raise ValueError(f"train + val + test must be 1, got {self.train + self.val + self.test:g}")

"""Transmission of a clip's frames into the video: each is lost, late or sent, with a time stamp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario


@dataclass(frozen=True)
class Slot:
    """One instant at which the camera takes a frame.

    ``pts`` is the presentation time in ticks of the stream, None if the frame is lost; ``repeated``: the previous
    picture is sent again instead of the frame.
    """

    frame: int
    time_s: float
    pts: int | None
    repeated: bool

    @property
    def shows_frame(self) -> bool:
        """Whether the video shows this frame."""
        return self.pts is not None and not self.repeated


def slots(scenario: Scenario, clip: int, ticks_per_s: int) -> Iterator[Slot]:
    """Go through a clip in order; see `simgrab.model.scenario.Clip` for what the settings mean.

    Time stamps, in ticks, increase: one that would precede the previous one is set to a tick after it.

    Examples
    --------
    >>> from simgrab.model.scenario import Clip
    >>> [slot.pts for slot in slots(Scenario(frames=3, clip=Clip(frame_rate_hz=25)), 0, 90_000)]
    [0, 3600, 7200]
    """
    settings = scenario.clip
    lost, late, jitter = (stream(scenario.seed, clip, f"clip.{name}") for name in ("drop", "repeat", "jitter"))
    latest = -1
    for index, frame in enumerate(settings.span(clip, scenario.frames)):
        # Every stream advances with every frame: what befalls one does not change what befalls the next.
        is_lost, is_late = lost.random() < settings.drop_share, late.random() < settings.repeat_share
        delay_s = jitter.normal() * settings.jitter_ms / 1000
        time_s = index / settings.frame_rate_hz
        if index == 0:
            is_lost, is_late, delay_s = False, False, 0.0
        if is_lost:
            yield Slot(frame, time_s, None, repeated=False)
            continue
        latest = max(latest + 1, round((time_s + delay_s) * ticks_per_s))
        yield Slot(frame, time_s, latest, repeated=is_late)

"""One record as arrays, and its estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate.contract import Estimator
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate


@dataclass(frozen=True, kw_only=True)
class PixelRecord:
    """One record of n frames."""

    pixels: Array  # (n, 2), grab centre as the picture has it; NaN where it was not found
    pixel_sd: Array  # (n,), standard deviation per coordinate, px; 0 where it is not stated
    rope_length: Array | None  # (n,), |OA|, m, NaN where it is not known; None if it is known nowhere
    time: Array | None  # (n,), seconds; None for independent frames

    def usable(self, *, rope: bool) -> NDArray[np.bool_]:
        """Which frames have a pixel and, where it is needed, a rope length: shape (n,)."""
        found = np.isfinite(self.pixels).all(axis=-1)
        return np.asarray(found & np.isfinite(self.rope_length) if rope and self.rope_length is not None else found)

    def part(self, some: NDArray[np.bool_] | NDArray[np.int64]) -> PixelRecord:
        """Take some of the frames: a mask (n,) or indices (m,)."""
        length, time = (None if of is None else of[some] for of in (self.rope_length, self.time))
        return PixelRecord(pixels=self.pixels[some], pixel_sd=self.pixel_sd[some], rope_length=length, time=time)

    def with_lengths(self, controller: Controller | None) -> Self:
        """Take the controller's rope lengths, and the record's own where it has none."""
        if controller is None or controller.rope is None:
            return self
        assert self.time is not None
        length = controller.rope_at(self.time)
        own = self.rope_length
        return replace(self, rope_length=length if own is None else np.where(np.isfinite(length), length, own))

    def estimate(self, estimator: Estimator, calibration: Calibration, until_s: float | None = None) -> Estimate:
        """Estimate from the usable frames, or from those of the first seconds; α is NaN in all others."""
        some = self.usable(rope=estimator.needs_rope)
        if until_s is not None and self.time is not None and len(some):
            some = some & (self.time < self.time[0] + until_s)
        part = self.part(some)
        found = estimator.estimate(
            part.pixels, calibration, rope_length=part.rope_length if estimator.needs_rope else None, time=part.time,
            pixel_sd=part.pixel_sd,
        )  # fmt: skip

        def whole(of_some: Array | None) -> Array | None:
            if of_some is None:
                return None
            full = np.full((len(some), *of_some.shape[1:]), np.nan)
            full[some] = of_some
            return full

        intervals = tuple(replace(one, alpha=whole(one.alpha)) for one in found.intervals)
        return replace(found, alpha=whole(found.alpha), swing=whole(found.swing), intervals=intervals)

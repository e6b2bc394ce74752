"""An oracle detector, which outputs the labels, for tests of later stages."""

import dataclasses

import numpy as np

from simgrab.model import label_arrays as labels
from simgrab.model.records.observations import Detection


@dataclasses.dataclass
class Oracle:
    """Answers for the pictures of a record in their order, with an error of so many pixels per coordinate.

    ``miss`` and ``shift`` are what goes wrong: every so manieth picture without a grab, and a bias to the right.
    """

    rows: list
    noise_px: float = 0.0
    miss: int = 0
    shift_px: float = 0.0
    count: int = 0
    name: str = "told"

    def __call__(self, picture):
        assert picture.dtype == np.uint8
        row = self.rows[self.count % len(self.rows)]
        self.count += 1
        box = labels.box(row)
        if box is None or (self.miss and self.count % self.miss == 0):
            return Detection("none", "nothing found", 0.1)
        rng = np.random.default_rng([7, self.count])
        off = rng.normal(0, self.noise_px, 2) + (self.shift_px, 0)
        sd = max(self.noise_px, 0.1)
        centre = labels.centre(row) + off
        return Detection("found", "", 0.9, box, centre, labels.yaw(row), np.full(4, sd), np.full(2, sd), 0.01)

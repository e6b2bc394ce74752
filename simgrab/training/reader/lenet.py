"""LeNet-5, after LeCun, Bottou, Bengio & Haffner, "Gradient-Based Learning Applied to Document Recognition" (1998)."""

from __future__ import annotations

from torch import Tensor, nn

from simgrab.instrument.read.reader import CLASSES


class LeNet5(nn.Module):
    """The net of section II.B: 32 × 32 grey pixels in, scores of eleven classes out.

    As there: C1 (6 maps, 5 × 5), S2, C3 (16 maps, 5 × 5), S4, C5 (120), F6 (84). Other than there: rectifiers for the
    scaled tangents, maxima for the trained averages of S2 and S4, all maps of S2 into each of C3, and logits for the
    distances from drawn bitmaps.
    """

    def __init__(self) -> None:
        super().__init__()
        self.c1 = nn.Conv2d(1, 6, 5)
        self.c3 = nn.Conv2d(6, 16, 5)
        self.c5 = nn.Conv2d(16, 120, 5)
        self.f6 = nn.Linear(120, 84)
        self.output = nn.Linear(84, CLASSES)
        self.subsample = nn.MaxPool2d(2)
        self.rectify = nn.ReLU()

    def forward(self, crops: Tensor) -> Tensor:
        """Logits, shape (n, 11), of crops, shape (n, 1, 32, 32)."""
        s2 = self.subsample(self.rectify(self.c1(crops)))
        s4 = self.subsample(self.rectify(self.c3(s2)))
        c5 = self.rectify(self.c5(s4)).flatten(1)
        logits: Tensor = self.output(self.rectify(self.f6(c5)))
        return logits

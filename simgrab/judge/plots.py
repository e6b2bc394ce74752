"""matplotlib, made ready for files: every module that draws a figure takes it from here.

Where it can keep no cache, as in a home that is read-only, it says so in two lines on stderr each time it is imported;
it does without, in a temporary folder, and so that is no news to a user.
"""

from __future__ import annotations

import logging

logging.getLogger("matplotlib").setLevel(logging.ERROR)

import matplotlib  # noqa: E402

matplotlib.use("Agg")

from matplotlib import rc_context  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.ticker import MultipleLocator  # noqa: E402

__all__ = ["Axes", "Figure", "MultipleLocator", "rc_context"]

"""matplotlib, made ready for files: every module that draws a figure takes it from here.

Its warnings are silenced: on each import it would report that its cache cannot be written, as in a read-only home, and
it uses a temporary folder instead.
"""

from __future__ import annotations

import logging

logging.getLogger("matplotlib").setLevel(logging.ERROR)

from matplotlib import rc_context  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.ticker import MultipleLocator  # noqa: E402

__all__ = ["Axes", "Figure", "MultipleLocator", "rc_context"]

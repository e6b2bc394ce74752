r"""Round NumPy's elementary functions differently, in every process that finds this file on its PYTHONPATH.

Kinds of CPU differ in the last bit of a sine. With ``LAST_BITS=1`` (another number, other bits) about half of the
results of sin, exp, log and their like move to a neighbouring double, for the same argument always to the same one.
What passes with it does not depend on the kind of CPU:

    LAST_BITS=1 PYTHONPATH=scripts/last_bits uv run pytest --deselect \
        tests/test_fence.py::test_the_pytest_plugin_is_light

The deselected test asserts that NumPy is not imported, and this file imports it.
"""

import os

FUNCTIONS = ("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "exp", "log", "log1p", "hypot")

if os.environ.get("LAST_BITS"):
    import contextlib
    from typing import Any

    import numpy as np

    with contextlib.suppress(ImportError):
        import ml_dtypes  # noqa: F401, registers loops of the true ufuncs; torch and ONNX import it

    SALT = np.uint64(2 * int(os.environ["LAST_BITS"]) + 1)
    GOLDEN = np.uint64(0x9E3779B97F4A7C15)

    def moved(result: Any) -> Any:
        """Move about half of the numbers to a neighbour; 0 and ±1 are exact on every CPU."""
        if np.asarray(result).dtype != np.float64:
            return result
        x = np.atleast_1d(result)
        with np.errstate(all="ignore"):
            dice = ((x.view(np.uint64) + SALT) * GOLDEN) >> np.uint64(62)
            neighbour = np.nextafter(x, np.where(dice == 0, np.inf, -np.inf))
        exact = (x == 0) | (np.abs(x) == 1) | ~np.isfinite(x)
        y = np.where(exact | (dice >= 2), x, neighbour).reshape(np.shape(result))
        return y if isinstance(result, np.ndarray) else np.float64(y)

    class Otherwise:
        """A ufunc whose results are `moved`; its methods and attributes are the ufunc's own."""

        def __init__(self, function: Any) -> None:
            self._function = function

        def __call__(self, *args: Any, **options: Any) -> Any:
            """Call the ufunc."""
            result = self._function(*args, **options)
            return result if options.get("out") is not None else moved(result)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._function, name)

    for name in FUNCTIONS:
        setattr(np, name, Otherwise(getattr(np, name)))

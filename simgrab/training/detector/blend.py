"""Weights between those before and those after a training: surer than either on what only one of them learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import onnx
from onnx import numpy_helper

from simgrab.dataset import datasets
from simgrab.errors import TrainingError
from simgrab.instrument.detect.bundled import PASSES, Bundled
from simgrab.instrument.detect.flips import WAYS
from simgrab.instrument.net import MOST_BYTES, open_net
from simgrab.io.destination import writing
from simgrab.io.files import drafted_folder
from simgrab.io.parse import read_bytes
from simgrab.training.card import rejudge
from simgrab.training.detector import cache, evaluate, export
from simgrab.training.detector.train import NETS, Watch
from simgrab.training.folder import check, write


def blend(
    before: Path, after: Path, out: Path, *, kept: Mapping[str, float], paths: Sequence[str | Path],
    easy: Sequence[str | Path] = (), watch: Watch | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Interpolate the weights of two detectors, and fit presence threshold and deviations again.

    A net that learned further forgets some of what it knew. Between its weights and those that it began with, it often
    does as well on both (Wortsman et al., "Robust fine-tuning of zero-shot models", 2022). Refine and settle look as
    often as in newly trained detectors. The presence threshold becomes no lower than before: users shall get no more
    false boxes because more is found.

    Parameters
    ----------
    before, after : Path
        Folders of a detector and of one that was trained from it.
    out : Path
        New. Gets the nets; a net ``verify`` is that of ``after``. Cards state the figures of the new detector.
    kept : mapping of str to float
        Share of ``before``, 0 to 1, for each of the nets in `simgrab.training.detector.train.NETS`.
    paths : sequence of paths
        Datasets whose frames of the split ``val`` neither has learned.
    easy : sequence of paths
        More of them, to which the deviations are fitted, and the threshold is not.
    watch : callable, optional
        As of `simgrab.training.detector.train.train`.

    Returns
    -------
    dict
        Figures on the validation frames.

    Raises
    ------
    DatasetError, TrainingError
        Also if the two are not of one architecture.
    """
    for name in NETS:
        if not 0 <= kept[name] <= 1:
            raise TrainingError(f"kept of {name} must lie between 0 and 1, got {kept[name]}")
    judged = datasets.read_all(paths, "val")
    frames = cache.frames(judged, "val")
    more = cache.frames(datasets.read_all(easy, "val"), "val") if easy else ()
    step = watch or (lambda _: lambda _done, _total: None)
    check(out, resume=False)
    with writing(out, TrainingError), drafted_folder(out) as draft:
        known = open_net(after / "settle.onnx", TrainingError).facts
        facts = {key: value for key, value in known.items() if key not in ("settings", "trust")}
        export.copy([*NETS, *(["verify"] if facts.get("verified") is True else [])], after, draft)
        for name in NETS:
            if kept[name] == 1:  # with the card of these weights, or none
                for card in (draft / f"{name}.json", draft / f"{name}.md"):
                    card.unlink(missing_ok=True)
                export.copy([name], before, draft)
                continue
            model = between(_opened(before / f"{name}.onnx"), _opened(after / f"{name}.onnx"), kept[name])
            write(draft / f"{name}.onnx", model.SerializeToString())
        export.restated(draft / "settle.onnx", facts)
        usual = {"least_presence": 0.0, "passes": PASSES, "flips": WAYS}
        looks = Bundled(draft, msgspec.structs.replace(Bundled(after).settings, **usual))
        seen = evaluate.watch(looks, frames, step("detecting in val images"))
        others = evaluate.watch(looks, more, step("detecting in easy val images")) if more else ()
        least = Bundled(before).settings.least_presence
        fitted, figures = evaluate.calibrated(looks, seen, easy=others, least=least)
        export.restated(draft / "settle.onnx", facts | fitted)
        for card in draft.glob("*.json"):
            share = kept.get(card.stem, 1.0)
            rejudge(card, [one.data for one in judged], figures, **({"kept": share} if share < 1 else {}))
    return figures


def between(first: onnx.ModelProto, second: onnx.ModelProto, kept: float) -> onnx.ModelProto:
    """Interpolate the numbers of two models of one architecture; all else is the second one's.

    Raises
    ------
    TrainingError
        If they are of two architectures.
    """
    result = onnx.ModelProto()
    result.CopyFrom(second)
    ones, others = first.graph.initializer, result.graph.initializer
    if [(node.op_type, len(node.input)) for node in first.graph.node] != [
        (node.op_type, len(node.input)) for node in result.graph.node
    ] or [one.dims for one in ones] != [other.dims for other in others]:
        raise TrainingError("the two detectors are of different architectures")
    for one, other in zip(ones, others, strict=True):
        a, b = numpy_helper.to_array(one), numpy_helper.to_array(other)
        if np.issubdtype(b.dtype, np.floating):
            mixed = kept * a.astype(np.float64) + (1 - kept) * b.astype(np.float64)
            other.CopyFrom(numpy_helper.from_array(mixed.astype(b.dtype), other.name))
    return result


def _opened(path: Path) -> onnx.ModelProto:
    open_net(path, TrainingError)  # refuses what names other files
    return onnx.load_from_string(read_bytes(path, TrainingError, most_bytes=MOST_BYTES))

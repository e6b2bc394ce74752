"""The error budget: the error of α that each stage adds while the stages before it get the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate import ESTIMATORS, Estimator, PaperIteration, RopeAware
from simgrab.instrument.estimate.follow import Known, follow
from simgrab.instrument.estimate.frames import mount_from_camera, tilt_of
from simgrab.instrument.run.runs import Run
from simgrab.judge.evaluate.swings import errors
from simgrab.judge.evaluate.truths import Truths
from simgrab.model import label_arrays as labels
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, on_ropes, swing_of, to_camera
from simgrab.model.rng import stream
from simgrab.model.truth import Row

_KNOWN_SD_M = 1e-4  # of a known offset
DRAWS = 20
_LEAST_DEG = 0.005  # of a contribution that is named
_LENS, _SAME_M = ("k1", "k2", "k3", "p1", "p2"), 0.01


@dataclass(frozen=True)
class BudgetStage:
    """A row of the budget.

    Attributes
    ----------
    name : str
    tilt : str
        ``"true"`` in every frame, ``"constant"``: the best that does not change, or ``"estimated"``, which for a run
        that was given its tilt, or found it in a part of its frames, is that tilt.
    camera : str
        ``"true"`` or ``"nominal"``: as the run knew it.
    rope : str
        ``"true"`` or ``"read"``.
    centre : str
        ``"true"``, ``"box"``: the centre of the true box, or ``"detected"``.
    """

    name: str
    tilt: str
    camera: str
    rope: str
    centre: str


READ = "rope's length as read"
CHAIN = (
    BudgetStage("everything true", "true", "true", "true", "true"),
    BudgetStage("tilt that does not change", "constant", "true", "true", "true"),
    BudgetStage("tilt estimated", "estimated", "true", "true", "true"),
    BudgetStage("camera as nominally known", "estimated", "nominal", "true", "true"),
    BudgetStage(READ, "estimated", "nominal", "read", "true"),
    BudgetStage("grab's centre as detected", "estimated", "nominal", "read", "detected"),
)
#: Beside the chain: one thing at a time.
ASIDE = (
    BudgetStage("true box's centre for the grab's", "estimated", "true", "true", "box"),
    BudgetStage("detected centre, all else true", "estimated", "true", "true", "detected"),
    BudgetStage("read length, all else true", "estimated", "true", "read", "true"),
)


def budget(run: Run, known: Truths) -> dict[str, Any] | None:
    """Follow the error of α through the stages; all rows use the same frames of the whole record.

    Returns
    -------
    dict or None
        ``estimator``; ``tilt``: ``"given"`` where the run had it from elsewhere or from a part of its frames, and so
        has the chain, else ``"estimated"``; rows as `simgrab.judge.evaluate.swings.errors` gives them, with the tilt
        ``beta_deg``: ``chain``, each with one more oracle input replaced, ``aside``, each with a single one replaced,
        ``paper``, the paper's method on true and on detected centres, ``drawn``, the last row of the chain with offsets
        drawn about the true one as the camera file states them to err (nothing for a tilt that was given, with its
        offset), and ``run``, the run's own angles; ``limit``: the stage that adds most. None where the run
        outputs no centres, where the true camera changes on the way, and where its estimator takes more than pixels.
    """
    parts = _Parts.of(run, known)
    if parts is None or len({_built(row) for row in parts.rows}) > 1:
        return None
    name = (run.about["estimate"] or run.about["tilt"] or {}).get("estimator", RopeAware.name)
    if name not in ESTIMATORS or "controller" in run.about:
        return None
    estimator = ESTIMATORS[name]()

    def row(stage: BudgetStage, by: Estimator) -> dict[str, Any]:
        beta, alpha = parts.swing(stage, by)
        return {"stage": stage.name, "beta_deg": beta} | errors(alpha, parts.alpha)

    paper, own = PaperIteration(), {"stage": "the run itself"} | errors(run.alpha[parts.some], parts.alpha)
    chain = [row(stage, estimator) for stage in CHAIN if parts.reads or stage.name != READ]
    return {
        "estimator": estimator.name,
        "tilt": "estimated" if parts.given is None else "given",
        "chain": chain,
        "limit": limit([*chain, own] if own["frames"] == chain[0]["frames"] else chain),
        "aside": [row(stage, estimator) for stage in ASIDE if parts.reads or stage.rope == "true"],
        "drawn": {"stage": f"offset drawn {DRAWS} times"} | parts.drawn(estimator),
        "paper": [row(stage, paper) for stage in (CHAIN[2], CHAIN[-1])],
        "run": own,
    }


def limit(chain: Sequence[Mapping[str, Any]]) -> str:
    """Name the stage that adds most to the mean square error, or the first that is refused."""
    for row in chain:
        if row["rmse_deg"] is None:
            return f"{row['stage']} (refused)"
    return str(chain[1 + int(np.argmax(np.diff([row["rmse_deg"] ** 2 for row in chain])))]["stage"])


def contributions(chain: Sequence[Mapping[str, Any]]) -> str:
    """Name all stages that add to the mean square error, with the root of what each adds, the largest first."""
    for row in chain:
        if row["rmse_deg"] is None:
            return f"{row['stage']} (refused)"
    added = zip(
        np.diff([row["rmse_deg"] ** 2 for row in chain]).tolist(), (row["stage"] for row in chain[1:]), strict=True
    )
    first, *others = sorted(added, key=lambda one: -one[0])
    texts = [f"{stage} ({square**0.5:.2f}°)" for square, stage in others if square > _LEAST_DEG**2]
    most = f"{first[1]} ({max(first[0], 0.0) ** 0.5:.2f}°)"
    return f"{most}; then {', '.join(texts)}" if texts else most


@dataclass(frozen=True)
class _Parts:
    """Inputs that can be true or measured, for the n frames in which both are known."""

    some: NDArray[np.bool_]  # of the run's frames
    alpha: Array
    rows: tuple[Row, ...]
    time: Array | None
    centre: dict[str, Array]
    rope: dict[str, Array]
    sd: Array
    camera: dict[str, Calibration]
    given: Known | None  # tilt that was not found in all of these frames
    reads: bool  # whether the run has lengths of the rope

    @classmethod
    def of(cls, run: Run, known: Truths) -> _Parts | None:
        read = run.rope_length
        reads = not np.isnan(read).all()
        used = read if reads else known.rope_length  # without a display the length plays no part
        centres = {"true": known.centre, "box": known.box_centre, "detected": run.pixels}
        finite = [np.isfinite(c).all(axis=-1) for c in centres.values()]
        some = np.logical_and.reduce([*finite, np.isfinite(known.alpha), np.isfinite(used)])
        if not some.any():
            return None
        rows = tuple(row for row, keep in zip(known.rows, some, strict=True) if keep and row is not None)
        sd = np.array([m.centre_sd or (0.0, 0.0) for m in run.measurements], float).reshape(-1, 2)
        return cls(
            some, known.alpha[some], rows, None if run.time is None else run.time[some],
            {name: centre[some] for name, centre in centres.items()},
            {"true": known.rope_length[some], "read": used[some]},
            np.sqrt(np.mean(sd**2, axis=-1))[some],
            {"true": true_camera(rows, run.calibration), "nominal": run.calibration}, _given(run),
            reads,
        )  # fmt: skip

    def swing(self, stage: BudgetStage, estimator: Estimator) -> tuple[float | None, Array]:
        """Tilt in degrees, if any, and swings (n,), rad, of a stage; NaN if the estimator refuses."""
        pixels, rope, camera = self.centre[stage.centre], self.rope[stage.rope], self.camera[stage.camera]
        if stage.tilt == "true":
            return None, swing_of(by_pose(self.rows, pixels, rope))[0]
        if stage.tilt == "constant":
            tilt = steady(self.rows, camera)
            return tilt.beta_deg, follow(tilt, pixels, camera, rope_length=rope)[0]
        if self.given is not None and estimator.name != PaperIteration.name:
            return self.given.beta_deg, follow(self.given, pixels, camera, rope_length=rope)[0]
        found = estimator.estimate(pixels, camera, rope_length=rope, time=self.time, pixel_sd=self.sd)
        if found.alpha is None or found.beta is None:
            return None, np.full(len(rope), np.nan)
        return float(np.rad2deg(found.beta)), found.alpha

    def drawn(self, estimator: Estimator) -> dict[str, Any]:
        """Errors of all draws of the offset together, without oracle inputs."""
        nominal, true = self.camera["nominal"], np.array(self.camera["true"].offset_m)
        off = [np.zeros(0)]
        for trial in range(DRAWS if self.given is None else 0):
            rng = stream(0, trial, "offset")
            x, y, z = (true + rng.normal(0, nominal.offset_sd_m, 3)).tolist()
            camera = msgspec.structs.replace(nominal, offset_m=(x, y, z))
            parts = replace(self, camera=self.camera | {"nominal": camera})
            off.append(parts.swing(CHAIN[-1], estimator)[1] - self.alpha)
        together = np.concatenate(off)
        return errors(together, np.zeros_like(together))


class Tilts(NamedTuple):
    """A run's tilt beside the true one.

    Attributes
    ----------
    used, true : Known
        The true one is the best that does not change.
    unlike_deg : float
        Root mean square difference of the run's angles from those that follow from its centres, lengths and tilt.
    rmse_deg : float
        RMSE of the angles that follow with the true tilt in place of its own.
    """

    used: Known
    true: Known
    unlike_deg: float
    rmse_deg: float


def of_tilt(run: Run, known: Truths) -> Tilts | None:
    """Compare a run's tilt with the true one; None if it states none, or no centres."""
    parts = None if run.about["tilt"] is None else _Parts.of(run, known)
    if parts is None:
        return None
    used, best = msgspec.convert(run.about["tilt"], Known), steady(parts.rows, run.calibration)
    true = msgspec.structs.replace(used, beta_deg=best.beta_deg, tilt_azimuth_deg=best.tilt_azimuth_deg)
    own, other = (
        follow(tilt, parts.centre["detected"], run.calibration, rope_length=parts.rope["read"])[0]
        for tilt in (used, true)
    )
    pairs = (own, run.alpha[parts.some]), (other, parts.alpha)
    unlike, rmse = (errors(*pair)["rmse_deg"] for pair in pairs)
    return None if unlike is None or rmse is None else Tilts(used, true, unlike, rmse)


def with_lengths(run: Run, known: Truths, rope: Literal["true", "read"]) -> Array:
    """Return swings (n,), rad, that follow from a run's centres and true or read lengths; NaN where one lacks."""
    parts, alpha = _Parts.of(run, known), np.full(len(run.measurements), np.nan)
    if parts is not None:
        stage = BudgetStage("", "estimated", "nominal", rope, "detected")
        alpha[parts.some] = parts.swing(stage, RopeAware())[1]
    return alpha


def by_centres(run: Run, known: Truths, rope: Literal["true", "read"] = "true") -> Array:
    """Return grab centres (n, 3), m, jib frame, that follow from a run's pixels and true or read lengths, or NaN."""
    parts, found = _Parts.of(run, known), np.full((len(run.measurements), 3), np.nan)
    if parts is not None and len({_built(row) for row in parts.rows}) == 1:
        found[parts.some] = by_pose(parts.rows, parts.centre["detected"], parts.rope[rope])
    return found


def _given(run: Run) -> Known | None:
    """Tilt of a run that was not found in all of its frames."""
    if run.about["tilt"] is None:
        return None
    tilt = msgspec.convert(run.about["tilt"], Known)
    return tilt if run.about["estimate"] is None or tilt.frames < np.isfinite(run.alpha).sum() else None


def _built(row: Row) -> tuple[float, ...]:
    """Lens and place of a row's camera, which do not change in a record; a mount may turn it."""
    return (
        row.fx_px, row.cx_px, row.cy_px, row.k1, row.k2, row.p1, row.p2, row.k3,
        row.offset_x_m, row.offset_y_m, row.offset_z_m,
    )  # fmt: skip


def true_camera(rows: Sequence[Row], nominal: Calibration) -> Calibration:
    """Return the true camera: lens and offset, and the mean roll."""
    row, roll = rows[0], np.angle(np.mean(np.exp(1j * np.deg2rad([row.roll_deg for row in rows]))))
    return msgspec.structs.replace(
        nominal, focal_length_px=row.fx_px, cx_px=row.cx_px, cy_px=row.cy_px,
        k1=row.k1, k2=row.k2, p1=row.p1, p2=row.p2, k3=row.k3, roll_deg=float(np.rad2deg(roll)),
        offset_m=(row.offset_x_m, row.offset_y_m, row.offset_z_m), offset_sd_m=_KNOWN_SD_M,
    )  # fmt: skip


def camera_errors(run: Run, known: Truths) -> str:
    """State which lens and offset of a run's camera file are not the true ones; a tilt estimated with them hides it."""
    rows = [row for row in known.rows if row is not None]
    if not rows or len({_built(row) for row in rows}) > 1:
        return ""
    used, true = run.calibration, true_camera(rows, run.calibration)
    most = {"focal_length_px": 1e-3 * true.focal_length_px, "cx_px": 1.0, "cy_px": 1.0} | dict.fromkeys(_LENS, 1e-3)
    pairs = [(name, getattr(used, name), getattr(true, name)) for name in most]
    found = [f"{name} {a:g} in place of {b:g}" for name, a, b in pairs if abs(a - b) > most[name]]
    if np.abs(np.subtract(used.offset_m, true.offset_m)).max() > max(2 * used.offset_sd_m, _SAME_M):
        a, b = (", ".join(f"{x:g}" for x in one.offset_m) for one in (used, true))
        found.append(f"offset_m [{a}] in place of [{b}]")
    return f"The run's camera file differs from the true camera: {'; '.join(found)}." if found else ""


def by_pose(rows: tuple[Row, ...], pixels: Array, rope: Array) -> Array:
    r"""Centre A (n, 3), m, jib frame, of a grab seen at pixels (n, 2) by cameras of known pose, with \|OA\| (n,)."""
    pose = np.array([row.jib_from_camera for row in rows]).reshape(-1, 3, 4)
    ray = np.einsum("nij,nj->ni", pose[:, :, :3], labels.intrinsics(rows[0]).rays(pixels))
    return on_ropes(pose[:, :, 3], ray, rope)


def steady(rows: tuple[Row, ...], camera: Calibration) -> Known:
    """Return the best constant tilt: towards the mean of gravity in the camera's frame."""
    rotations = np.array([row.jib_from_camera for row in rows]).reshape(-1, 3, 4)[:, :, :3]
    down = to_camera(np.array([0.0, 0.0, -1.0]), rotations, np.zeros(3)).mean(axis=0)
    beta, azimuth = tilt_of(mount_from_camera(camera) @ down)
    nothing = tuple((0.0,) * 4 for _ in range(4))
    return Known(
        "truth", len(rows), float(np.rad2deg(beta)), float(np.rad2deg(azimuth)), camera.offset_m, nothing,
        roll_deg=camera.roll_deg,
    )  # fmt: skip

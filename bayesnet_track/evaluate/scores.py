"""Scores of one pass over a sequence, from its boxes and the true ones, also by confidence."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

THRESHOLDS = np.linspace(0.0, 1.0, 21)
PRECISION_PX = 20.0
EPISODE_FRAMES = 5
BANDS = ("above 0.5", "up to 0.5", "none", "absent")
"""Overlap with the true box; `absent` where the target has none."""

StatusTable = Mapping[str, Mapping[str, int]]
"""Status -> band of `BANDS` -> number of frames."""


@dataclass(frozen=True)
class TrackScore:
    """Scores of one target. Shares are 0..1; None where there was nothing to measure.

    Attributes:
        frames: frames of the pass, the first included.
        scored_frames: those in which the truth has a box; only they count for accuracy.
        auc: OTB success: mean over the thresholds 0, 0.05 .. 1 of the share of frames whose IoU is above it.
        auc_strict: the same where a frame reported as lost has IoU 0.
        precision20: share of frames whose centre is within 20 px of the true one.
        mean_iou: mean intersection over union.
        lost_episodes: maximal stretches of at least 5 scored frames with IoU 0.
        first_lost: the frame in which the first of them begins, or None: a row of the truth, of `score_run`
            the number of the frame in the source.
        reported_lost: frames whose status was lost, or that have no box.
        lost_when_off: share of the frames with IoU 0 that were reported as lost.
        lost_when_on: share of the frames with IoU above 0 that were reported as lost.
        fps: frames per second, the first frame not counted.
        mean_active: agents per frame.
        coverage50: share of frames whose true centre lies in the 50 % region, in x and in y; the given
            frame 0 is left out.
        coverage90: the same of the 90 % region.
        long_precision: precision of long-term tracking (`long_term`) at the score with the largest F; None,
            like the next ones, unless the target is absent in some frames.
        long_recall: recall there.
        long_f: the largest F over the score.
        long_f_at: that score.
        statuses: status -> overlap -> frames; None without statuses.
    """

    frames: Annotated[int, ""]
    scored_frames: Annotated[int, "frames with ground truth"]
    auc: Annotated[float, "OTB success: share of frames whose IoU is above 0, 0.05 .. 1, on average"]
    auc_strict: Annotated[float, "the same, with IoU 0 where the target was reported as lost"]
    precision20: Annotated[float, "share of frames whose centre is within 20 px"]
    mean_iou: Annotated[float, "mean overlap with the true box"]
    lost_episodes: Annotated[int, "stretches of 5 frames or more without any overlap"]
    first_lost: Annotated[int | None, "number of the frame in which the first one begins"]
    reported_lost: Annotated[int, "frames in which the target was reported as lost, or had ended"]
    lost_when_off: Annotated[float | None, "share of the frames without overlap that were reported as lost"]
    lost_when_on: Annotated[float | None, "share of the frames with overlap that were reported as lost"]
    fps: Annotated[
        float | None, "frames per second of tracking alone: decoding, drawing and writing left out"
    ] = None
    mean_active: Annotated[float | None, "agents per frame"] = None
    coverage50: Annotated[
        tuple[float, float] | None, "share of frames with the true centre in the 50 % region, in x and in y"
    ] = None
    coverage90: Annotated[tuple[float, float] | None, "the same for the 90 % region"] = None
    long_precision: Annotated[
        float | None, "VOT-LT: mean overlap where the score is high enough, 0 while absent"
    ] = None
    long_recall: Annotated[
        float | None, "VOT-LT: mean overlap where the target is present, 0 at lower scores"
    ] = None
    long_f: Annotated[float | None, "their harmonic mean, at the score where it is largest"] = None
    long_f_at: Annotated[float | None, "that score"] = None
    statuses: StatusTable | None = None

    def text(self, explained: bool = False) -> str:
        """One figure a line: its name and value, and with `explained` what it says and the statuses.

        The figures of long-term tracking are left out where the target is never absent.
        """
        lines = []
        for name, meaning in meanings(TrackScore).items():
            if name.startswith("long_") and self.long_f is None:
                continue
            line = f"{name:<14} {_show(getattr(self, name))}"
            lines.append(f"{line:<26} {meaning}".rstrip() if explained else line)
        if explained and self.statuses is not None:
            lines += ["", _status_text(self.statuses)]
        return "\n".join(lines)

    @property
    def misjudged(self) -> tuple[int, int]:
        """Frames `tracking` at an overlap up to 0.5 or without a target; frames not so at one above 0.5."""
        table = self.statuses or {}
        wrong = sum(count for band, count in table.get("tracking", {}).items() if band != BANDS[0])
        return wrong, sum(row[BANDS[0]] for status, row in table.items() if status != "tracking")

    def json(self) -> str:
        """One JSON object, keys in the order of the class."""
        return json.dumps(asdict(self))


def meanings(kind: Any) -> Mapping[str, str]:
    """Meanings of the figures of a class of scores: field -> the text of its annotation, in order."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if get_origin(hint) is Annotated}


def score_pass(
    boxes: ArrayLike,
    lost: ArrayLike,
    truth: ArrayLike,
    *,
    seconds: ArrayLike | None = None,
    active: ArrayLike | None = None,
    region50: ArrayLike | None = None,
    region90: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    statuses: Sequence[str] | None = None,
) -> TrackScore:
    """Scores of one pass of n frames.

    Args:
        boxes: (n, 4) reported corner boxes in px; frame 0 is the start and counts, as in the OTB toolkit.
            NaN rows where nothing is reported, as after the target's end: `lost` is True there, the IoU is 0,
            and the frame does not count for speed, agents and coverage.
        lost: (n,) True where the target was reported as lost.
        truth: (n, 4) true corner boxes; NaN rows where the target is absent.
        seconds: (n,) wall time of each frame.
        active: (n,) number of active agents.
        region50: (n, 4) x_low, x_high, y_low, y_high of the centre's 50 % region in px.
        region90: the same of the 90 % region.
        confidence: (n,) score of each frame, for the figures of long-term tracking.
        statuses: (n,) status of each frame.

    Raises:
        ValueError: lengths differ, a box or a confidence is not finite, or no frame has a true box.
    """
    reported, given_up, true, present = _checked(boxes, lost, truth)
    frame_seconds, agents, trust = (
        _rows(name, values, true.shape[:1])
        for name, values in (("seconds", seconds), ("active", active), ("confidence", confidence))
    )
    narrow, wide = (
        _rows(name, values, true.shape) for name, values in (("region50", region50), ("region90", region90))
    )
    reported_mask: NDArray[np.bool_] = np.asarray(np.isfinite(reported).all(axis=1))
    centre, true_centre = centre_from_corner(reported[present]), centre_from_corner(true[present])
    iou, gone = np.where(reported_mask[present], overlap(centre, true_centre), 0.0), given_up[present]
    episodes = lost_episodes(iou)
    long = None if trust is None else _long_term(iou, trust, present)
    return TrackScore(
        frames=len(true),
        scored_frames=int(present.sum()),
        auc=success_auc(iou),
        auc_strict=success_auc(np.where(gone, 0.0, iou)),
        precision20=float((np.hypot(*(centre - true_centre)[:, :2].T) <= PRECISION_PX).mean()),
        mean_iou=float(iou.mean()),
        lost_episodes=len(episodes),
        first_lost=int(np.flatnonzero(present)[episodes[0]]) if episodes else None,
        reported_lost=int(given_up.sum()),
        lost_when_off=_share(gone[iou == 0]),
        lost_when_on=_share(gone[iou > 0]),
        fps=None if frame_seconds is None else frames_per_second(frame_seconds[reported_mask]),
        mean_active=None if agents is None else _mean(agents[reported_mask]),
        coverage50=_coverage(narrow, present & reported_mask, centre_from_corner(true)),
        coverage90=_coverage(wide, present & reported_mask, centre_from_corner(true)),
        long_precision=None if long is None else long.precision,
        long_recall=None if long is None else long.recall,
        long_f=None if long is None else long.f,
        long_f_at=None if long is None else long.threshold,
        statuses=None if statuses is None else _status_table(statuses, _spread(iou, present), present),
    )


def _spread(iou: Floats, present: NDArray[np.bool_]) -> Floats:
    """Overlaps of the frames with a true box as those of all frames, 0 elsewhere."""
    all_frames = np.zeros(len(present))
    all_frames[present] = iou
    return all_frames


def _checked(
    boxes: ArrayLike, lost: ArrayLike, truth: ArrayLike
) -> tuple[Floats, NDArray[np.bool_], Floats, NDArray[np.bool_]]:
    """Boxes, lost and truth as arrays, and in which frames the target is present; raises as `score_pass`."""
    reported, true = np.asarray(boxes, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    given_up = np.asarray(lost, dtype=bool)
    if (
        reported.shape != true.shape
        or true.ndim != 2
        or true.shape[1] != 4
        or given_up.shape != true.shape[:1]
    ):
        raise ValueError(
            f"boxes {reported.shape}, lost {given_up.shape}, truth {true.shape}: must be (n, 4), (n,), (n, 4)"
        )
    wrong = ~np.isfinite(reported).all(axis=1) & ~(np.isnan(reported).all(axis=1) & given_up)
    if wrong.any():
        raise ValueError(
            f"box of frame {int(wrong.argmax())} is not finite: give finite numbers, "
            "or a row of NaN with lost True where nothing is reported"
        )
    present: NDArray[np.bool_] = np.asarray(np.isfinite(true).all(axis=1))
    if not present.any():
        raise ValueError("the truth has no box in any of these frames")
    return reported, given_up, true, present


def _rows(name: str, values: ArrayLike | None, shape: tuple[int, ...]) -> Floats | None:
    """An optional array as numbers; raises ValueError where it does not have a row for each of the truth."""
    if values is None:
        return None
    rows = np.asarray(values, dtype=np.float64)
    if rows.shape != shape:
        raise ValueError(
            f"{name} {rows.shape}: must be {shape}, one row for each of the truth; leave it out if unknown"
        )
    if name == "confidence" and not np.isfinite(rows).all():
        row = int((~np.isfinite(rows)).argmax())
        raise ValueError(
            f"confidence of frame {row} is {rows[row]}: a finite number is needed; "
            "give a frame without one the smallest of all"
        )
    return rows


def _long_term(iou: Floats, confidence: Floats, present: NDArray[np.bool_]) -> LongTerm | None:
    """Figures of long-term tracking, where the target is absent in some; the first is given."""
    if present.all():
        return None
    return long_term([Confident(_spread(iou, present)[1:], confidence[1:], present[1:])])


def _status_table(statuses: Sequence[str], iou: Floats, present: NDArray[np.bool_]) -> StatusTable:
    """Numbers of frames: the status in the order of its first frame, each band even where nothing is in it.

    Args:
        statuses: (n,) tracking, uncertain, lost, hidden or ended.
        iou: (n,) overlap with the true box.
        present: (n,) whether there is a true box.
    """
    bands = np.where(present, np.where(iou > 0.5, 0, np.where(iou > 0.0, 1, 2)), 3)
    table = {status: dict.fromkeys(BANDS, 0) for status in statuses}
    for status, band in zip(statuses, bands.tolist(), strict=True):
        table[status][BANDS[band]] += 1
    return table


def _status_text(table: StatusTable) -> str:
    """The table in lines, without a column of absent targets where there are none."""
    columns = [band for band in BANDS if band != "absent" or any(row[band] for row in table.values())]
    width = max(map(len, ("status", *table)))
    head = f"{'status':<{width}}  " + "  ".join(f"{band:>9}" for band in columns)
    rows = (
        f"{name:<{width}}  " + "  ".join(f"{row[band]:>9}" for band in columns) for name, row in table.items()
    )
    return "\n".join(["frames by status and by overlap with the true box:", head, *rows])


def success_auc(iou: Floats) -> float:
    """Mean over the 21 thresholds of the share of (n,) overlaps strictly above each (OTB)."""
    return float((iou[:, None] > THRESHOLDS).mean())


def lost_episodes(iou: Floats, length: int = EPISODE_FRAMES) -> list[int]:
    """First index of every maximal stretch of at least `length` overlaps of 0.

    >>> lost_episodes(np.array([1, 0, 0, 0, 0, 0, 1, 0, 0]))
    [1]
    """
    steps = np.diff(np.concatenate([[0], (iou <= 0).astype(int), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [int(start) for start, end in zip(starts, ends, strict=True) if end - start >= length]


def frames_per_second(seconds: ArrayLike) -> float | None:
    """(n - 1) over the time of all frames but the first, which pays for the start; None for one frame."""
    later_seconds = np.asarray(seconds, dtype=np.float64)[1:]
    return len(later_seconds) / float(later_seconds.sum()) if later_seconds.sum() > 0 else None


def _show(value: object) -> str:
    if isinstance(value, tuple):
        return _pair(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)


def _pair(value: tuple[float, float] | None) -> str:
    return "-" if value is None else f"{value[0]:.2f} {value[1]:.2f}"


def _share(flags: NDArray[np.bool_]) -> float | None:
    return float(flags.mean()) if flags.size else None


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if values.size else None


def _coverage(
    region: Floats | None, counted: NDArray[np.bool_], centre: Floats
) -> tuple[float, float] | None:
    if region is None or not counted[1:].any():  # the start is given, not estimated
        return None
    bounds, centre = region[1:][counted[1:]], centre[1:][counted[1:]]
    is_within = [(bounds[:, 2 * k] <= centre[:, k]) & (centre[:, k] <= bounds[:, 2 * k + 1]) for k in (0, 1)]
    return float(is_within[0].mean()), float(is_within[1].mean())


@dataclass(frozen=True, eq=False)
class Confident:
    """One sequence, each frame after the first, which is given.

    Attributes:
        iou: (n,) overlap with the true box; 0 where the target is absent.
        confidence: (n,) of the tracker.
        present: (n,) whether the target has a true box.
    """

    iou: Floats
    confidence: Floats
    present: NDArray[np.bool_]


@dataclass(frozen=True)
class LongTerm:
    """The best point of the curve.

    Attributes:
        precision: mean overlap of the frames with a confidence of at least the threshold; 0 where absent.
        recall: mean overlap of the frames in which the target is present; 0 below the threshold.
        f: harmonic mean of both.
        threshold: confidence at which `f` is largest, the highest such one.
    """

    precision: float
    recall: float
    f: float
    threshold: float


def long_term(sequences: Sequence[Confident]) -> LongTerm | None:
    """Precision, recall and F at the confidence threshold with the largest F; None without a target to find.

    Precision and recall of a threshold are means over sequences (Lukezic et al., Performance Evaluation
    Methodology for Long-Term Single-Object Tracking, 2020). A sequence in which nothing is reported at a
    threshold does not count for its precision; one without a frame that has the target, not for its recall.
    """
    sequences_shown = [sequence for sequence in sequences if len(sequence.iou)]
    if not any(sequence.present.any() for sequence in sequences_shown):
        return None
    levels = np.unique(np.concatenate([sequence.confidence for sequence in sequences_shown]))
    curves = [_curve(sequence, levels) for sequence in sequences_shown]
    precision = np.nanmean([curve[0] for curve in curves], axis=0)
    recall = np.nanmean(
        [curve[1] for curve, sequence in zip(curves, sequences_shown, strict=True) if sequence.present.any()],
        axis=0,
    )
    total = precision + recall
    f = np.divide(2.0 * precision * recall, total, out=np.zeros_like(total), where=total > 0.0)
    best_index = len(f) - 1 - int(np.argmax(f[::-1]))
    return LongTerm(
        float(precision[best_index]),
        float(recall[best_index]),
        float(f[best_index]),
        float(levels[best_index]),
    )


def _curve(sequence: Confident, levels: Floats) -> tuple[Floats, Floats]:
    """Precision and recall at each of the ascending levels; NaN precision where nothing is reported."""
    order = np.argsort(sequence.confidence, kind="stable")
    first = np.searchsorted(sequence.confidence[order], levels, side="left")
    iou_sums = np.append(np.cumsum(sequence.iou[order][::-1])[::-1], 0.0)[first]
    reported = (len(order) - first).astype(np.float64)
    precision = np.divide(iou_sums, reported, out=np.full(len(levels), np.nan), where=reported > 0)
    return precision, iou_sums / max(int(sequence.present.sum()), 1)

"""Scores on the ground, in metres: of places and identities, and of the uncertainty that a run claims.

A ground truth is a CSV file with the columns t (s), id, x, y (m); a run's places are the columns of its
``tracks.csv``. A place is right within 1 m; MODP rates distances up to 0.5 m.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from bayesnet_track.evaluate.gospa import ORDER, gospa
from bayesnet_track.evaluate.mot import clear_mot, identity
from bayesnet_track.evaluate.paired_boxes import BoxPairs, EdgeList
from bayesnet_track.evaluate.scores import meanings
from bayesnet_track.evaluate.truth import assign_rows
from bayesnet_track.journal.metrics import NOT_SHOWN
from bayesnet_track.journal.reader import read_seconds
from bayesnet_track.numerics.arrays import Array, Floats, Ints
from bayesnet_track.sources.entrances.notices import few, notice

MATCH_M = 1.0
"""Largest distance of a right place."""
_BEYOND_M = MATCH_M * (1 + 1e-9)
"""Gains of pairs are what they are nearer than this: one at `MATCH_M` still gains."""
PRECISE_M = 0.5
"""Distance at which MODA and MODP are computed, as for WILDTRACK."""
TRUTH = ("t", "id", "x", "y")
TRACKS = ("time_s", "target", "x_m", "y_m")
UNCERTAIN = ("x_m_sd", "y_m_sd", "xy_corr")
SHARE = 0.9


@dataclass(frozen=True, eq=False)
class GroundPlaces:
    """Places on the ground.

    Attributes:
        times: (N,) s.
        ids: (N,) names.
        points: (N, 2) m.
        covariances: (N, 2, 2) m^2; nan where nothing is claimed.
    """

    times: Floats
    ids: Sequence[str]
    points: Floats
    covariances: Floats


@dataclass(frozen=True)
class WorldScore:
    """Scores of places on the ground. Shares are 0..1, MODA and MOTA at most 1."""

    instants: Annotated[int, "times of the ground truth that are scored"]
    true_ids: Annotated[int, "targets"]
    true_places: Annotated[int, "their places"]
    track_ids: Annotated[int, "tracks"]
    track_places: Annotated[int, "their places at these times"]
    moda: Annotated[float, "1 - (misses + false) / true places, at 0.5 m"]
    modp: Annotated[float, "mean of 1 - distance / 0.5 m, of the places matched at 0.5 m"]
    mota: Annotated[float, "1 - (fn + fp + idsw) / true places, at 1 m"]
    fp: Annotated[int, "places without a true one"]
    fn: Annotated[int, "true places without a tracked one"]
    idsw: Annotated[int, "identity switches"]
    idf1: Annotated[float, "2 x places on the target's own track / all places, true and tracked"]
    cutoff_m: Annotated[float, "cut-off c of GOSPA, m"]
    gospa_m: Annotated[float, "root mean square GOSPA of the instants, p = 2, m"]
    error_m: Annotated[float | None, "mean distance of the places matched at 1 m"]
    anees: Annotated[float | None, "mean normalised squared error of matched places / 2; 1 is calibrated"]
    anees_low: Annotated[float | None, "95 % of calibrated runs lie above this, errors correlated as here"]
    anees_high: Annotated[float | None, "and below this; more is overconfident"]
    coverage: Annotated[float | None, "share of matched true places inside their 90 % ellipse"]
    crps_m: Annotated[float | None, "continuous ranked probability score of x and y, mean, m"]

    def text(self) -> str:
        """A line for each figure, with its meaning."""
        kinds = meanings(WorldScore)
        width = max(map(len, kinds))
        values = ((name, getattr(self, name)) for name in kinds)
        formatted = (
            (n, "-" if v is None else f"{v:.4g}" if isinstance(v, float) else str(v)) for n, v in values
        )
        return "\n".join(f"{name:{width}}  {value:>9}  {kinds[name]}" for name, value in formatted)

    def json(self) -> str:
        """The figures as JSON."""
        return json.dumps(asdict(self))


def is_world_truth(path: Path) -> bool:
    """True for a CSV file whose header line has t, id, x and y, and no width or height.

    False where it cannot be read: whoever reads it as something else says what is wrong.
    """
    try:
        with path.open("rb") as file:
            first = file.readline(4096)
    except OSError:
        return False
    words = first.decode("utf-8-sig", "replace").lower().replace(";", ",").split(",")
    names = {word.strip() for word in words}
    return names >= set(TRUTH) and not names & {"w", "h", "width", "height"}


def read_world_truth(path: Path) -> GroundPlaces:
    """Places of a ground truth.

    Raises:
        OSError: the file cannot be read.
        ValueError: a column is missing, a line is malformed, or an id is twice in an instant; says file and
        line.
    """
    return _read(path, TRUTH, (), frozenset())


def read_world_tracks(path: Path) -> GroundPlaces:
    """Places of ``tracks.csv``; targets that are lost or hidden are left out.

    Raises:
        OSError: the file cannot be read.
        ValueError: there are no places in metres, or a line is malformed; says file and line.
    """
    return _read(path, TRACKS, UNCERTAIN, frozenset(NOT_SHOWN))


def _read(
    path: Path, names: Sequence[str], uncertain: Sequence[str], left_out: frozenset[str]
) -> GroundPlaces:
    times, ids, rows = [], [], []
    first_lines: dict[tuple[float, str], int] = {}
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        columns = [str(name).strip() for name in reader.fieldnames or ()]
        reader.fieldnames = columns
        missing = [name for name in names if name not in columns]
        if missing:
            raise ValueError(
                f"{path}:1: no column {', '.join(missing)}; allowed: a header with {', '.join(names)}"
            )
        if not uncertain and (extra := [name for name in columns if name not in names]):
            notice(f"{path}: not used: the columns {few(extra)}")
        has_sd = bool(uncertain) and set(uncertain) <= set(columns)
        for row in reader:
            location = f"{path}:{reader.line_num}"
            if row.get("status") in left_out or (uncertain and not row[names[2]]):
                continue
            try:
                time, x, y = (float(row[name]) for name in (names[0], *names[2:]))
                sd_x, sd_y, corr = (float(row[n]) for n in uncertain) if has_sd else (math.nan,) * 3
            except (TypeError, ValueError):
                raise ValueError(f"{location}: {', '.join(names)} must be numbers, id a name") from None
            if not all(map(math.isfinite, (time, x, y))):
                raise ValueError(f"{location}: a number is not finite")
            key = time, str(row[names[1]]).strip()
            if key in first_lines:
                raise ValueError(
                    f"{location}: {key[1]!r} is at t = {time:g} already, in line {first_lines[key]}"
                )
            first_lines[key] = reader.line_num
            times.append(time)
            ids.append(key[1])
            rows.append((x, y, sd_x**2, sd_y**2, corr * sd_x * sd_y))
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return GroundPlaces(np.array(times), ids, table[:, :2], table[:, [2, 4, 4, 3]].reshape(-1, 2, 2))


def end_of_run(folder: Path, tracks: Path) -> float:
    """Time of a run's last frame, s; infinity where no target says how long frames last.

    Raises:
        OSError: the tracks cannot be read.
    """
    frames = [frame for frame, _ in read_seconds(folder / "timings.jsonl")]
    with tracks.open(encoding="utf-8", newline="") as file:
        times = {int(row["frame"]): float(row["time_s"]) for row in csv.DictReader(file)}
    if not frames or not times or max(times) == 0:
        return math.inf
    final = max(times)
    return times[final] + (max(frames) - final + 0.5) * times[final] / final


def score_world(
    truth: GroundPlaces, tracks: GroundPlaces, *, until: float = math.inf, cutoff_m: float = MATCH_M
) -> WorldScore:
    """Scores of places against a ground truth, at the times of the truth.

    A track's place counts for the nearest time of the truth, within half of the truth's shortest interval.

    Args:
        truth: the true places.
        tracks: the tracked ones.
        until: time of the truth after which nothing is scored, s.
        cutoff_m: cut-off c of GOSPA, m.

    Raises:
        ValueError: nothing to score, no common time, or a cut-off of 0 or less.
    """
    instants = np.unique(truth.times[truth.times <= until])
    if not len(instants):
        raise ValueError("the ground truth has no place to score")
    interval = float(np.diff(instants).min()) if len(instants) > 1 else math.inf
    true_at, tracked_at = (
        _nearest(instants, truth.times, 1e-9),
        _nearest(instants, tracks.times, interval / 2),
    )
    if len(tracks.times) and not (tracked_at >= 0).any():
        raise ValueError(
            f"no time in common: the ground truth has t from {instants[0]:g} to {instants[-1]:g} s, the "
            "tracks from "
            f"{tracks.times.min():g} to {tracks.times.max():g} s"
        )
    tracked_at = _once(tracked_at, instants, tracks)
    pairs = {cut: _pairs(truth, tracks, true_at, tracked_at, cut) for cut in (MATCH_M, PRECISE_M)}
    clear, precise = clear_mot(pairs[MATCH_M]), clear_mot(pairs[PRECISE_M])
    errors = _errors(truth, tracks, true_at, tracked_at)
    total = precise.tp + precise.fn
    return WorldScore(
        instants=len(instants),
        true_ids=len(pairs[MATCH_M].true_boxes),
        true_places=int((true_at >= 0).sum()),
        track_ids=len(pairs[MATCH_M].tracked_boxes),
        track_places=int((tracked_at >= 0).sum()),
        moda=1 - (precise.fn + precise.fp) / total,
        modp=2 * precise.motp - 1 if precise.tp else 0.0,
        mota=clear.mota,
        fp=clear.fp,
        fn=clear.fn,
        idsw=clear.idsw,
        idf1=identity(pairs[MATCH_M]).idf1,
        cutoff_m=cutoff_m,
        gospa_m=gospa(pairs[MATCH_M], cutoff_m, ORDER).total_px,
        **_uncertainty(errors),
    )


def _nearest(instants: Floats, times: Floats, tolerance: float) -> Ints:
    """Place of the nearest instant of each time, -1 beyond the tolerance."""
    if not len(times):
        return np.empty(0, dtype=np.int64)
    upper = np.clip(np.searchsorted(instants, times), 1, max(len(instants) - 1, 1))
    lower = upper - 1
    upper = np.minimum(upper, len(instants) - 1)
    nearest = np.where(times - instants[lower] <= instants[upper] - times, lower, upper)
    return np.where(np.abs(instants[nearest] - times) <= tolerance * (1 + 1e-9), nearest, -1)


def _once(indices: Ints, instants: Floats, tracks: GroundPlaces) -> Ints:
    """Of a track with several places near one instant, the nearest alone."""
    best_rows: dict[tuple[int, str], int] = {}
    for row in np.flatnonzero(indices >= 0).tolist():
        key = int(indices[row]), tracks.ids[row]
        rival = best_rows.get(key)
        if rival is None or abs(tracks.times[row] - instants[indices[row]]) < abs(
            tracks.times[rival] - instants[indices[row]]
        ):
            best_rows[key] = row
    filtered = np.full_like(indices, -1)
    rows = list(best_rows.values())
    filtered[rows] = indices[rows]
    return filtered


@dataclass(frozen=True, eq=False)
class _PlaceBlock:
    """`Block` of places of one instant, with similarities and distances (G, K)."""

    true: Ints
    tracked: Ints
    true_frames: Ints
    tracked_frames: Ints
    similarity: Floats
    distance: Floats

    @property
    def overlapping(self) -> EdgeList:
        """Pairs with their similarity, above 0."""
        i, j = np.nonzero(self.similarity)
        return i, j, self.similarity[i, j]

    def nearer(self, cutoff: float) -> EdgeList:
        """Pairs with their distance, below the cut-off."""
        i, j = np.nonzero(self.distance < cutoff)
        return i, j, self.distance[i, j]


def _pairs(
    truth: GroundPlaces, tracks: GroundPlaces, true_at: Ints, tracked_at: Ints, cut_m: float
) -> BoxPairs:
    """All pairs; their similarity is 1 - distance / (2 cut), so that it is 0.5 at the cut-off."""
    rows = [np.flatnonzero(indices >= 0) for indices in (true_at, tracked_at)]
    numbers = [
        np.unique(
            np.array([places.ids[k] for k in row.tolist()], dtype=str),
            return_inverse=True,
            return_counts=True,
        )
        for places, row in ((truth, rows[0]), (tracks, rows[1]))
    ]
    blocks, length = [], 0
    ids = [number[1].astype(np.int64) for number in numbers]
    for instant in np.unique(np.concatenate([true_at[rows[0]], tracked_at[rows[1]]])).tolist():
        i, j = (indices[row] == instant for indices, row in zip((true_at, tracked_at), rows, strict=True))
        differences = truth.points[rows[0][i]][:, None] - tracks.points[rows[1][j]][None]
        distance = np.hypot(differences[..., 0], differences[..., 1])
        similarity = np.maximum(1 - distance / (2 * cut_m), 0.0)
        true_frames, tracked_frames = (np.full(size, instant) for size in distance.shape)
        blocks.append(_PlaceBlock(ids[0][i], ids[1][j], true_frames, tracked_frames, similarity, distance))
        length = instant + 1
    true_boxes, tracked_boxes = (number[2].astype(np.int64) for number in numbers)
    return BoxPairs(tuple(blocks), true_boxes, tracked_boxes, length)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Matched places: differences (N, 2), covariances (N, 2, 2), and the number of the target (N,)."""

    offsets: Floats
    covariances: Floats
    targets: Sequence[str]


def _errors(truth: GroundPlaces, tracks: GroundPlaces, true_at: Ints, tracked_at: Ints) -> _Errors:
    offsets, covariances, targets = [], [], []
    for instant in np.unique(true_at[true_at >= 0]).tolist():
        i, j = np.flatnonzero(true_at == instant), np.flatnonzero(tracked_at == instant)
        differences = tracks.points[j][None] - truth.points[i][:, None]
        distance = np.hypot(differences[..., 0], differences[..., 1])
        for row, column in zip(*assign_rows(np.maximum(_BEYOND_M - distance, 0.0)), strict=True):
            if distance[row, column] <= MATCH_M:
                offsets.append(differences[row, column])
                covariances.append(tracks.covariances[j[column]])
                targets.append(truth.ids[int(i[row])])
    return _Errors(np.array(offsets).reshape(-1, 2), np.array(covariances).reshape(-1, 2, 2), targets)


def _uncertainty(errors: _Errors) -> dict[str, float | None]:
    """Figures of the claimed uncertainty; None where nothing is matched, or nothing claimed."""
    from scipy.stats import chi2, norm

    names = ("anees", "anees_low", "anees_high", "coverage", "crps_m")
    if not len(errors.offsets):
        return dict.fromkeys(("error_m", *names))
    error = float(np.hypot(errors.offsets[:, 0], errors.offsets[:, 1]).mean())
    claimed = errors.covariances
    has_claim = claimed[:, 0, 0] * claimed[:, 1, 1] > claimed[:, 0, 1] ** 2  # not where nothing is claimed
    if not has_claim.any():
        return {"error_m": error, **dict.fromkeys(names)}
    offsets, covariances = errors.offsets[has_claim], errors.covariances[has_claim]
    squares = np.einsum("ni,ni->n", offsets, np.linalg.solve(covariances, offsets[..., None])[..., 0])
    count = _independent(squares, np.array(errors.targets)[has_claim])
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    z = offsets / sd
    crps = sd * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / math.sqrt(math.pi))
    low, high = (float(chi2.ppf(level, 2 * count) / (2 * count)) for level in (0.025, 0.975))
    return {
        "error_m": error,
        "anees": float(squares.mean() / 2),
        "anees_low": low,
        "anees_high": high,
        "coverage": float((squares <= chi2.ppf(SHARE, 2)).mean()),
        "crps_m": float(crps.mean()),
    }


def _independent(squares: Floats, names: Array) -> float:
    """Number of independent errors with the spread of these, which are correlated over time.

    Per target N / (1 + 2 sum of the autocorrelations up to the first that is not positive).
    """
    count = 0.0
    for name in np.unique(names):
        series = squares[names == name] - squares[names == name].mean()
        power = float(series @ series)
        total = 0.0
        for lag in range(1, len(series)):
            correlation = float(series[lag:] @ series[:-lag]) / power if power > 0 else 0.0
            if correlation <= 0:
                break
            total += correlation
        count += len(series) / (1 + 2 * total)
    return max(count, 1.0)

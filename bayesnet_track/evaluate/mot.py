"""Scores of several targets at once: MOTA, IDF1 and HOTA, with what they are made of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bayesnet_track.evaluate.clear_mot import clear_mot
from bayesnet_track.evaluate.hota import ALPHAS, hota
from bayesnet_track.evaluate.identity import identity
from bayesnet_track.evaluate.mot_files import read_mot_tracks, read_mot_truth
from bayesnet_track.evaluate.mot_pairs import Tracks, pair

MEANINGS: Mapping[str, str] = {
    "frames": "up to the last that has a box",
    "true_ids": "targets",
    "true_boxes": "their boxes",
    "track_ids": "tracks",
    "track_boxes": "their boxes",
    "mota": "1 - (fn + fp + idsw) / true boxes",
    "motp": "mean IoU of the matched boxes",
    "fp": "tracked boxes that match no true one",
    "fn": "true boxes that no tracked one matches",
    "idsw": "identity switches",
    "idf1": "2 x boxes on the target's own track / all boxes, true and tracked",
    "idp": "share of the tracked boxes that are on their own target",
    "idr": "share of the true boxes that are on their own track",
    "hota": "sqrt(deta x assa), mean over IoU from .05, .1 .. .95, as are the three below",
    "deta": "detection: matched / (matched + missed + false)",
    "assa": "association: how much of its target and its track a matched pair has in common",
    "loca": "mean IoU of the matched boxes",
}


@dataclass(frozen=True)
class MotScore:
    """How well several targets were followed. Shares are 0..1, MOTA at most 1.

    Attributes:
        frames: number of frames up to the last with a box, true or tracked.
        true_ids: true targets.
        true_boxes: their boxes.
        track_ids: tracks.
        track_boxes: their boxes.
        mota: accuracy by CLEAR MOT at IoU 0.5.
        motp: mean IoU of the pairs it matches; 0 when it matches none.
        fp: tracked boxes without a true one.
        fn: true boxes without a tracked one.
        idsw: identity switches.
        idf1: identity score at IoU 0.5.
        idp: its precision.
        idr: its recall.
        hota: mean of its curve, as are
        deta: detection accuracy,
        assa: association accuracy,
        loca: localisation accuracy.
        alphas: thresholds of IoU of the curves.
        hota_at: HOTA at each.
        deta_at: DetA at each.
        assa_at: AssA at each; 0 where nothing matches.
        loca_at: LocA at each; 1 where nothing matches.
    """

    frames: int
    true_ids: int
    true_boxes: int
    track_ids: int
    track_boxes: int
    mota: float
    motp: float
    fp: int
    fn: int
    idsw: int
    idf1: float
    idp: float
    idr: float
    hota: float
    deta: float
    assa: float
    loca: float
    alphas: tuple[float, ...]
    hota_at: tuple[float, ...]
    deta_at: tuple[float, ...]
    assa_at: tuple[float, ...]
    loca_at: tuple[float, ...]

    def text(self, explained: bool = False) -> str:
        """One figure a line, the curves left out: its name and value, and with `explained` what it says."""
        lines = []
        for name, meaning in MEANINGS.items():
            value = getattr(self, name)
            line = f"{name:<14} {value if isinstance(value, int) else format(value, '.4f')}"
            lines.append(f"{line:<26} {meaning}" if explained else line)
        return "\n".join(lines)

    def json(self) -> str:
        """One JSON object, keys in the order of the class."""
        return json.dumps(asdict(self))


def score_mot(truth: Tracks, tracks: Tracks) -> MotScore:
    """Scores of tracks against the truth; every frame counts, also those that only one of the two has.

    Raises:
        ValueError: the truth has no box.
    """
    if not len(truth):
        raise ValueError("the truth has no box")
    pairs = pair(truth, tracks)
    clear, own, higher = clear_mot(pairs), identity(pairs), hota(pairs)
    return MotScore(
        frames=1 + int(max(truth.frames.max(), tracks.frames.max(initial=0))),
        true_ids=len(pairs.true_boxes),
        true_boxes=len(truth),
        track_ids=len(pairs.tracked_boxes),
        track_boxes=len(tracks),
        mota=clear.mota,
        motp=clear.motp,
        fp=clear.fp,
        fn=clear.fn,
        idsw=clear.idsw,
        idf1=own.idf1,
        idp=own.idp,
        idr=own.idr,
        hota=float(higher.hota.mean()),
        deta=float(higher.deta.mean()),
        assa=float(higher.assa.mean()),
        loca=float(higher.loca.mean()),
        alphas=tuple(np.round(ALPHAS, 2).tolist()),
        hota_at=tuple(higher.hota.tolist()),
        deta_at=tuple(higher.deta.tolist()),
        assa_at=tuple(higher.assa.tolist()),
        loca_at=tuple(higher.loca.tolist()),
    )


def score_mot_files(tracks_path: str | Path, truth_path: str | Path) -> MotScore:
    """Scores of a tracks file against a ground-truth file, both MOT.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file; says file and line.
    """
    return score_mot(read_mot_truth(truth_path), read_mot_tracks(tracks_path))

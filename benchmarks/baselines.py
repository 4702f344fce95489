"""Each classical tracker alone, as the one agent of a net, beside OpenCV's own on real sequences.

    python benchmarks/baselines.py DATA_FOLDER [--seeds 1] [--max-frames 200] [--sequences A,B] [--only klt]

DATA_FOLDER is as for sequences.py. Agents that measure stand under a Gaussian belief, those that score under
particles; the motion is a random walk relative to the box. One pass from the first true box, no restarts.
AUC is the area under the success curve (OTB); frames per CPU second count the work without decoding.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from measuring import Image, environment, on_one_thread, table
from peers import Corner, MeanShift, Peer, peers
from sequences import Sequence, find_sequences, track

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import Score
from bayesnet_track.graph.spec import GraphSpec

GAUSSIAN = {"gaussian": {"gate": 1.0}}
PARTICLES = {"particles": {"size": 500}}
AGENTS: dict[str, tuple[object, object]] = {
    "mean_shift": ("mean_shift", GAUSSIAN),
    "camshift": ("camshift", GAUSSIAN),
    "klt": ("klt", GAUSSIAN),
    "displacement": ("displacement", GAUSSIAN),
    "color_kernel_histogram": ("color_kernel_histogram", PARTICLES),
    "opencv_tracker: MIL": ({"opencv_tracker": {"tracker": "MIL"}}, GAUSSIAN),
}


def net(agent: object, belief: object) -> GraphSpec:
    """One agent under one node; references are learnt while the target is not lost."""
    walk = {"sd_box": {"x": 0.15, "y": 0.15}, "sd_log": {"scale": 0.02}}
    root = {
        "belief": belief,
        "motion": {"random_walk": walk},
        "estimate": "mean",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_box": 0.9}, "rate_max": 0.02},
    }
    nodes = {"target": root, "only": {"parent": "target", "agent": agent}}
    return GraphSpec.model_validate(
        {"bayesnet": 1, "name": "baseline", "targets": {"target": {"nodes": nodes}}}
    )


class CamShift(MeanShift):
    """`cv2.CamShift` on the same back-projection; the upright box round its window."""

    def update(self, image: Image) -> tuple[bool, Corner]:
        """The box in the next picture."""
        hsv, colourful = self._hue(image)
        back = cv2.calcBackProject([hsv], [0], self._histogram, [0, 180], 1) & colourful
        _, window = cv2.CamShift(back, self._window, self.stop)
        self._window = window if min(window[2:]) > 0 else self._window
        x, y, w, h = self._window
        return True, (float(x), float(y), float(w), float(h))


class Points:
    """`cv2.goodFeaturesToTrack`, `cv2.calcOpticalFlowPyrLK`: the box goes with their median, and its size."""

    def init(self, image: Image, box: Corner) -> None:
        """Start in the box."""
        self._gray, self._box = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), box
        self._choose()

    def _choose(self) -> None:
        x, y, w, h = (round(value) for value in self._box)
        mask = np.zeros_like(self._gray)
        mask[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = 255
        found = cv2.goodFeaturesToTrack(self._gray, 40, 0.01, 5, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if found is None else found.reshape(-1, 1, 2)

    def update(self, image: Image) -> tuple[bool, Corner]:
        """The box in the next picture; points are chosen anew when fewer than ten are left."""
        gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        before = self._points
        if len(before) == 0:
            self._gray = gray
            return False, self._box
        after, there, _ = cv2.calcOpticalFlowPyrLK(self._gray, gray, before, None)
        again, back, _ = cv2.calcOpticalFlowPyrLK(gray, self._gray, after, None)
        good = (there & back).ravel().astype(bool) & (np.linalg.norm(again - before, axis=2).ravel() < 1.5)
        self._gray = gray
        if not good.any():
            self._points = before[:0]
            return False, self._box
        old, new = before[good][:, 0], after[good][:, 0]
        dx, dy = np.median(new - old, axis=0)
        spread = [
            np.linalg.norm(p[:, None] - p[None], axis=2)[np.triu_indices(len(p), 1)] for p in (old, new)
        ]
        scale = float(np.median(spread[1] / np.maximum(spread[0], 1e-6))) if len(old) > 3 else 1.0
        x, y, w, h = self._box
        x, y = x + w / 2 + float(dx), y + h / 2 + float(dy)
        w, h = w * scale, h * scale
        self._box = (x - w / 2, y - h / 2, w, h)
        self._points = new[:, None]
        if len(new) < 10:
            self._choose()
        return True, self._box


def rivals() -> dict[str, Callable[[], Peer]]:
    """OpenCV's own counterparts."""
    known = peers()
    found: dict[str, Callable[[], Peer]] = {
        "cv2.meanShift": MeanShift,
        "cv2.CamShift": CamShift,
        "cv2 points": Points,
    }
    return {
        **found,
        **{f"cv2.Tracker{name}": known[name] for name in ("MIL", "KCF", "CSRT") if name in known},
    }


def passes(make: Callable[[int], Peer | Tracker], sequence: Sequence, seeds: int) -> list[Score]:
    """Scores of one pass per seed."""
    scores = []
    for seed in range(seeds):
        cv2.setRNGSeed(seed)
        scores.append(track(make(seed), sequence).score(sequence.truth))
    return scores


def main() -> None:
    """Print a row per tracker: AUC on each sequence, their mean, lost episodes, frames per CPU second."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--max-frames", type=int, default=200)
    parser.add_argument("--sequences", default="", help="comma-separated names; default all")
    parser.add_argument("--only", default="", help="comma-separated trackers; default all")
    options = parser.parse_args()
    on_one_thread()
    wanted = [name for name in options.sequences.split(",") if name]
    sequences = find_sequences(options.data, wanted, options.max_frames)
    if not sequences:
        raise SystemExit(f"{options.data}: no NAME/img/*.jpg with NAME/groundtruth.txt")
    print(f"{environment()}; up to {options.max_frames} frames, {options.seeds} seeds\n")
    print(table(["AUC", *(s.name for s in sequences), "**mean**", "lost episodes", "frames / CPU s"], []))
    only = [name for name in options.only.split(",") if name]
    runs: dict[str, tuple[Callable[[int], Peer | Tracker], int]] = {
        name: (partial(Tracker, net(agent, belief)), options.seeds)
        for name, (agent, belief) in AGENTS.items()
    }
    runs |= {name: (lambda _, make=make: make(), 1) for name, make in rivals().items()}
    for name, (make, seeds) in runs.items():
        if only and name not in only:
            continue
        scores = [passes(make, sequence, seeds) for sequence in sequences]
        auc = [float(np.mean([one.auc for one in several])) for several in scores]
        every = [one for several in scores for one in several]
        episodes = np.mean([one.lost_episodes for one in every])
        speed = np.mean([one.fps for one in every if one.fps is not None])
        cells = [
            name,
            *(f"{v:.3f}" for v in auc),
            f"**{np.mean(auc):.3f}**",
            f"{episodes:.1f}",
            f"{speed:.0f}",
        ]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()

"""Cues for worker processes, which import them by name: well behaved until told otherwise."""

from __future__ import annotations

import os
import signal
import stat
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import numpy as np

from bayesnet_track import CueDeclaration, CueParameters
from bayesnet_track.observation.cue import Measurement, blend_arrays

ENGINE = os.getpid()
"""Where this was first imported: what is done to a worker only is not done there."""


class Parameters(CueParameters):
    how: Literal[
        "well",
        "raise",
        "own error",
        "mute",
        "leave",
        "complex",
        "masked",
        "objects",
        "paint",
        "bend",
        "rename",
        "die",
        "exit",
        "hang",
        "deaf",
        "eat",
        "garble",
        "short",
        "words",
        "stranger",
        "slow",
    ] = "well"
    seconds: float = 0.0
    at: int = 3
    engine: int = 0
    times: str = ""
    x: float = 55.0
    big: int = 0


@dataclass(frozen=True)
class Mean:
    """The gray level of the picture in `WholePicture`'s words: something that depends on both frames."""

    margin: None = None
    inputs: tuple = ()
    is_points: bool = True

    def compute(self, frames, inputs, region):
        before = 0.0 if frames.previous is None else float(frames.previous.image.mean())
        return np.array([float(frames.current.image.mean()), before])


class OwnError(Exception):
    def __str__(self):
        return "of my own"


class MuteError(Exception):
    def __str__(self):
        raise RuntimeError("mute")


def misbehave(p, index):
    """What is done in frame `at`, or from -`at` on; with `times`, a file, only as often as it has lines."""
    if p.how == "slow" and index >= p.at and os.getpid() != p.engine:
        time.sleep(p.seconds)
    if os.getpid() == p.engine or (index != p.at if p.at >= 0 else index < -p.at):
        return None
    if p.times:
        left = Path(p.times).read_text().splitlines()
        if not left:
            return None
        Path(p.times).write_text("\n".join(left[1:]))
    match p.how:
        case "raise":
            raise ValueError(f"no good in frame {index}")
        case "own error":
            raise OwnError
        case "mute":
            raise MuteError
        case "leave":
            sys.exit(3)
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "exit":
            os._exit(7)
        case "hang":
            time.sleep(3600)
        case "deaf":
            for number in range(1, 64):
                if number not in (signal.SIGKILL, signal.SIGSTOP):
                    try:
                        signal.signal(number, signal.SIG_IGN)
                    except (OSError, ValueError):
                        continue
            time.sleep(3600)
        case "garble":
            for number in range(3, 32):
                try:
                    if stat.S_ISSOCK(os.fstat(number).st_mode):
                        os.write(number, b"\xff" * 64)
                except OSError:
                    continue
        case "eat":
            eaten = [np.ones(1 << 24) for _ in range(64)]
            raise AssertionError(f"{sys.getsizeof(eaten)} were not refused")
    return p.how


@dataclass(frozen=True)
class Placed:
    parameters: Parameters
    needs: tuple = (Mean(),)
    context = 0.5

    def learn(self, planes, box):
        return {"box": np.array(box), "big": np.full(1000 + self.parameters.big, planes[self.needs[0]][0])}

    def blend(self, old, new, rate):
        return blend_arrays(old, new, rate)

    def log_likelihood(self, planes, hypotheses, reference):
        p = self.parameters
        what = misbehave(p, planes.frame.index)
        if what == "short":
            return np.zeros(len(hypotheses) - 1)
        if what == "words":
            return ["good"] * len(hypotheses)
        if what == "paint":
            planes[self.needs[0]][...] = 3.0
            planes.frame.image[...] = 3
        if what == "bend":
            reference["big"][...] = 3.0
        if what == "rename":
            reference["more"] = reference.pop("big")
        if what == "complex":
            return np.full(len(hypotheses), -1.0 + 1.0j)
        if what == "masked":
            return np.ma.masked_less(np.full(len(hypotheses), -1.0), -2.0)
        if what == "objects":
            return np.full(len(hypotheses), -1.0).astype(object)
        now, before = planes[self.needs[0]]
        away = hypotheses.boxes[:, 0] - p.x - 0.1 * now + 0.1 * before + 0.001 * reference["big"][7]
        return np.log(0.02 + 0.98 * np.exp(-0.5 * (away / 15.0) ** 2))


@dataclass(frozen=True)
class PlacedMeasurer:
    parameters: Parameters
    needs: tuple = (Mean(),)

    def learn(self, planes, box):
        return {"box": np.array(box)}

    def blend(self, old, new, rate):
        return blend_arrays(old, new, rate)

    def measure(self, planes, hypotheses, weights, reference):
        if misbehave(self.parameters, planes.frame.index) == "stranger":
            return SimpleNamespace(mean=3)
        return Measurement(("x", "y"), weights @ hypotheses.boxes[:, :2], np.diag([9.0, 16.0]))

    def adapt(self, reference, attempt):
        return {"box": reference["box"] + 1.0} if attempt < 2 else None


def make(parameters):
    return Placed(parameters)


def make_measurer(parameters):
    return PlacedMeasurer(parameters)


CUES = {
    "placed": CueDeclaration("placed", "", Parameters, make),
    "placed_measurer": CueDeclaration(
        "placed_measurer", "", Parameters, make_measurer, measures=True, adapts=True
    ),
    "kept": CueDeclaration("kept", "", Parameters, make, opaque=True),
    "unnamed": CueDeclaration("unnamed", "", Parameters, lambda parameters: Placed(parameters)),
}

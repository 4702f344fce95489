"""Whole nets in a worker: its own engine of the same graph, which advances the targets that it is asked for.

To the worker it is an agent like others; what it is asked is `advance`, and it needs the frames themselves.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.step import make_engine
from bayesnet_track.engine.target_execution import Advanced, advance
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.inference.compile import Plan, compile_plan
from bayesnet_track.journal.net.net import Net
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.observation.planes import FramePair, Plane, PlaneCache, Planes, Region


@dataclass(frozen=True)
class BothFrames:
    """The plane whose value is the frames themselves: an array of one object, their pair."""

    margin: None = None
    inputs: tuple[Plane, ...] = ()
    is_points: bool = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The pair."""
        pair: NDArray[np.object_] = np.empty(1, dtype=object)
        pair[0] = frames
        return pair


BOTH_FRAMES = BothFrames()


@dataclass(frozen=True, eq=False)
class TargetRequest:
    """What is asked for one target: its net, and its state without the plan; None for the one held here."""

    net: TargetNet
    state: TargetState | None


class NetHost:
    """The nets of some targets of one graph."""

    needs: tuple[Plane, ...] = (BOTH_FRAMES,)

    def __init__(self, graph: CheckedGraph, seed: int) -> None:
        # What detectors find is the engine's business; of a file of detections there is none here.
        wanted = {
            kind.birth.detector.detector for kind in graph.spec.targets.values() if kind.birth is not None
        }
        unused: Any = {GIVEN: None} if GIVEN in wanted else {}
        self._engine = make_engine(graph, seed, detectors=unused)
        self._held: dict[str, TargetState] = {}
        self._plans: dict[tuple[str, frozenset[str]], Plan] = {}

    def advance(self, planes: Planes, asked: bytes) -> bytes:
        """Target -> what its frame gave, of the targets asked for; both as bytes.

        No bytes when a state is asked for that is not held here: by a fresh worker.
        """
        cache = PlaneCache(planes[BOTH_FRAMES][0])
        given: Mapping[str, TargetRequest] = pickle.loads(asked)
        if any(one.state is None and target not in self._held for target, one in given.items()):
            return b""
        net = Net({target: one.net for target, one in given.items()})
        work = FrameWork(self._engine, net, cache)
        made = {target: self._advance(work, target, one) for target, one in given.items()}
        self._held = {target: one.done.state for target, one in made.items()}
        return pickle.dumps(
            {target: _without_plan(one) for target, one in made.items()}, protocol=pickle.HIGHEST_PROTOCOL
        )

    def _advance(self, work: FrameWork, target: str, asked: TargetRequest) -> Advanced:
        state = self._held[target] if asked.state is None else asked.state
        return advance(work, target, replace(state, plan=self._plan(asked.net)))

    def _plan(self, net: TargetNet) -> Plan:
        key = net.template, net.active
        if key not in self._plans:
            compiled = self._engine.plates[net.template]
            self._plans[key] = compile_plan(compiled.plate, net.active, compiled.cues)
        return self._plans[key]


def make_net_host(parameters: tuple[CheckedGraph, int]) -> Any:
    """The nets of a graph and a seed."""
    return NetHost(*parameters)


def _without_plan(one: Advanced) -> Advanced:
    """Both sides compile their plans themselves."""
    state: Any = replace(one.done.state, plan=None)  # type: ignore[arg-type]
    return replace(one, done=replace(one.done, state=state))

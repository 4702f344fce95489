"""The answering side: cues at work in another process, asked one question at a time.

It holds nothing between frames but copies of what the engine told it, so that a new one answers alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bayesnet_track.observation.cue import FAULTS, AnyCue, Measurement, foreign_part, real_numbers, text_of
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, shown
from bayesnet_track.runtime.executors.messages import (
    LEARN_AND_BLEND,
    Answer,
    Call,
    EncodedReference,
    Foreign,
    Received,
)

CACHES = 2
"""Pairs of frames whose planes are kept."""


class AgentHost:
    """Cues by agent, the planes of the current frames, and the references that were told.

    `frame_of` fetches a frame from where `Call.frames` says that it lies; `is_limited` says that memory
    is, so that running out of it is nothing that the cue does everywhere.
    """

    def __init__(self, frame_of: Callable[[Any], Frame], is_limited: bool = False) -> None:
        self._frame_of, self._is_limited = frame_of, is_limited
        self._cues: dict[str, AnyCue] = {}
        self._received = Received()
        self._caches: dict[tuple[int, int], PlaneCache] = {}

    def assign(self, agent: str, make: Callable[[Any], AnyCue], parameters: Any) -> None:
        """Make the cue of an agent."""
        self._cues[agent] = make(parameters)

    def unassign(self, agent: str) -> None:
        """Drop the cue of an agent."""
        self._cues.pop(agent, None)

    def answer(self, question: Call) -> Answer:
        """What the cue says; whatever it raises is told, not raised."""
        started = time.perf_counter()
        try:
            value = self._ask(question)
            return Answer(value, seconds=time.perf_counter() - started)
        except FAULTS as error:  # a guest's code: the engine decides what comes of it
            seconds = time.perf_counter() - started
            if self._is_limited and _is_shortage(error):
                return Answer(out_of_memory=True, seconds=seconds)
            return Answer(raised=(type(error).__name__, text_of(error)), seconds=seconds)

    def _ask(self, question: Call) -> Any:
        received = self._received
        received.forget(question.forget)
        cue: Any = self._cues[question.agent]
        arguments: list[Any] = [
            shown(received.reference(part)) if isinstance(part, EncodedReference) else part
            for part in question.arguments
        ]
        if question.frames is not None:
            assert question.region is not None
            planes = self._cache(question.frames).planes(cue.needs, question.region)
            arguments.insert(1 if question.method == LEARN_AND_BLEND else 0, planes)
        if question.method == LEARN_AND_BLEND:
            learn, seen, old, rate, *box = arguments
            returned = cue.blend(old, getattr(cue, learn)(seen, *box), rate)
        else:
            returned = getattr(cue, question.method)(*arguments)
        match question.method:
            case "log_likelihood":
                numbers = real_numbers(returned)
                return Foreign(numbers) if isinstance(numbers, str) else numbers
            case "measure":
                return _measurement(returned)
        if returned is None and question.method == "adapt":
            return None
        # As the engine looks at what a cue learnt: what is no mapping fails in the same words.
        reference: Mapping[str, Any] = dict(returned.items())
        given = [part for part in question.arguments if isinstance(part, EncodedReference)]
        return received.encode(reference, given, question.next_number)

    def _cache(self, frames: tuple[Any, Any]) -> PlaneCache:
        current, previous = frames
        key = (current.number, -1 if previous is None else previous.number)
        cache = self._caches.get(key)
        if cache is None:
            while len(self._caches) >= CACHES:
                del self._caches[next(iter(self._caches))]
            pair = FramePair(self._frame_of(current), None if previous is None else self._frame_of(previous))
            cache = self._caches[key] = PlaneCache(pair)
        return cache


def _measurement(returned: Any) -> Measurement | Foreign | None:
    """A measurement of plain arrays, which the engine checks; another object as what it is not."""
    if returned is None:
        return None
    is_measurement = isinstance(returned, Measurement)
    foreign = foreign_part(returned) if is_measurement else type(returned).__name__
    if foreign:
        return Foreign(foreign)
    fields = tuple(str(name) for name in returned.fields)
    mean, covariance = np.array(returned.mean, float), np.array(returned.covariance, float)
    choices: list[tuple[float, Measurement]] = []
    for weight, one in returned.choices:
        own = _measurement(one)
        if not isinstance(own, Measurement):
            return Foreign("Measurement with a choice that is none")
        choices.append((float(weight), own))
    return Measurement(fields, mean, covariance, returned.floor, tuple(choices), returned.confidence)


def _is_shortage(error: BaseException) -> bool:
    return isinstance(error, MemoryError) or "Insufficient memory" in text_of(error)

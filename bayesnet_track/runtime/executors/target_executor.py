"""The engine's side of nets at work elsewhere: who has which target, and what each has to be told."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.target_execution import Advanced
from bayesnet_track.inference.executor import AgentUnavailable
from bayesnet_track.journal.net.net import Net
from bayesnet_track.observation.planes import FramePair, Region
from bayesnet_track.runtime.executors.proxy import Transport
from bayesnet_track.runtime.executors.questions import ADVANCE, Call
from bayesnet_track.runtime.executors.target_host import TargetRequest

REMEMBERED = tuple(item.name for item in fields(TargetState) if item.name != "plan")


@dataclass(frozen=True, eq=False)
class _Request:
    """What one worker was asked for in a frame, and the answer to come."""

    targets: Mapping[str, TargetState]
    answer: Callable[[], bytes]


class ProcessTargetExecutor:
    """Advances targets in the workers behind a transport.

    Each has a share of the targets, those that it had before. A worker that is lost has forgotten their
    states: it is asked again with all of them, and what it still does not advance is left to the engine.

    Args:
        transport: where questions are handed in.
        hosts: names that the transport knows the workers by.
        plates: of which targets are taken.
    """

    def __init__(self, transport: Transport, hosts: Sequence[str], plates: frozenset[str]) -> None:
        self.plates = plates
        self._transport, self._hosts = transport, tuple(hosts)
        self._host_of: dict[str, str] = {}
        self._returned: dict[str, TargetState] = {}

    def start(
        self, net: Net, targets: Mapping[str, TargetState], frames: FramePair
    ) -> Callable[[], Mapping[str, Advanced]]:
        """Have the targets advanced; see `inference.executor.TargetExecutor`."""
        self._share_out(targets)
        where = self._transport.send_frame(frames.previous) if frames.previous is not None else None
        both = self._transport.send_frame(frames.current), where
        whole = Region(0, 0, frames.current.width, frames.current.height)
        requests = []
        for host in self._hosts:
            own = {target: state for target, state in targets.items() if self._host_of[target] == host}
            if own:
                requests.append(_Request(own, self._request(host, net, own, both, whole)))
        return lambda: self._collect(requests)

    def _share_out(self, targets: Mapping[str, TargetState]) -> None:
        """New targets to the workers with the fewest; when shares have grown apart, all anew."""
        self._returned = {target: state for target, state in self._returned.items() if target in targets}
        self._host_of = {target: host for target, host in self._host_of.items() if target in targets}
        counts = dict.fromkeys(self._hosts, 0)
        for host in self._host_of.values():
            counts[host] += 1
        for target in targets:
            if target not in self._host_of:
                host = min(self._hosts, key=lambda name: counts[name])
                self._host_of[target] = host
                counts[host] += 1
        if max(counts.values()) - min(counts.values()) > 1:
            self._returned.clear()
            self._host_of = {
                target: self._hosts[number % len(self._hosts)] for number, target in enumerate(targets)
            }

    def _request(
        self, host: str, net: Net, own: Mapping[str, TargetState], both: tuple[Any, Any], whole: Region
    ) -> Callable[[], bytes]:
        """What waits for the answer of a worker, which is asked now."""
        known = {target: self._is_held(target, state) for target, state in own.items()}
        call = Call(host, ADVANCE, both, whole, (_question(net, own, known),))
        answered = self._transport.begin(call)
        # A fresh worker holds no state: it says nothing, and is told all of them.
        return lambda: answered() or self._transport.ask(call._replace(arguments=(_question(net, own, {}),)))

    def _is_held(self, target: str, state: TargetState) -> bool:
        """Whether the state is the one that the worker returned last: nobody has changed it since."""
        held = self._returned.get(target)
        return held is not None and all(getattr(held, name) is getattr(state, name) for name in REMEMBERED)

    def _collect(self, requests: Sequence[_Request]) -> dict[str, Advanced]:
        advanced: dict[str, Advanced] = {}
        for request in requests:
            try:
                made: Mapping[str, Advanced] = pickle.loads(request.answer())
            except AgentUnavailable:
                for target in request.targets:
                    self._returned.pop(target, None)
                continue
            for target, one in made.items():
                state = replace(one.done.state, plan=request.targets[target].plan)
                self._returned[target] = state
                advanced[target] = replace(one, done=replace(one.done, state=state))
        return advanced


def _question(net: Net, own: Mapping[str, TargetState], known: Mapping[str, bool]) -> bytes:
    asked = {}
    for target, state in own.items():
        bare: Any = None if known.get(target) else replace(state, plan=None)  # type: ignore[arg-type]
        asked[target] = TargetRequest(net.targets[target], bare)
    return pickle.dumps(asked, protocol=pickle.HIGHEST_PROTOCOL)

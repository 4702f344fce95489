"""Beliefs of every frame as lines of ``beliefs.jsonl``, for what is done with them after the run.

A line has the frame, the target, the time, what the motion into the frame depended on, the belief, and what
the agents said: particles, and each agent's log-likelihood of them, as float32 (weights as logarithms), a
Gaussian and what was measured as float64, a grid by its heaviest cells. Arrays are little-endian, in base64.
A particle takes 5.4 bytes per field, weight and agent.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.grid.cells import AXIS, GridBelief
from bayesnet_track.belief.motion.composed import Influences
from bayesnet_track.belief.motion.delayed import CameraShift
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.engine.groups import AgentMessages
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.checks.factors import delay_of
from bayesnet_track.graph.spec import AgentNode, GraphSpec, InferenceNode
from bayesnet_track.journal.encoder import JournalError, short
from bayesnet_track.journal.writer import LineFile
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.observation.settings import setting

MOST_CELLS = 4000
"""Cells of a grid that are kept: the heaviest."""


KeptPosterior = ParticleSet | GaussianPosterior | ModalPosterior


@dataclass(frozen=True, eq=False)
class KeptBelief:
    """The belief about a target after a frame.

    Attributes:
        frame: index of the frame.
        target: target id.
        time: time of the frame, frame intervals.
        posterior: the belief.
        influences: what the motion into the frame depended on besides the states; None where on nothing.
        heard: what the agents said in the frame.
    """

    frame: int
    target: str
    time: float
    posterior: KeptPosterior
    influences: Influences | None = None
    heard: AgentMessages = field(default_factory=AgentMessages)


class UnkeptBeliefError(ValueError):
    """A graph has a belief that cannot be kept."""


def check_kept(graph: GraphSpec) -> None:
    """Check that every belief of a graph can be kept.

    Raises:
        UnkeptBeliefError: one has a past, or depends on those of other targets.
    """
    joined = {kind for join in graph.joins for kind in join.between or ()}
    for kind, plate in graph.targets.items():
        for name, agent in plate.nodes.items():
            if isinstance(agent, AgentNode) and delay_of(agent):
                keep = setting("--keep-beliefs")
                raise UnkeptBeliefError(
                    f"{keep}: {kind}.{name} has a delay, and beliefs with their past cannot be smoothed yet; "
                    f"allowed: no delay, or no {keep}"
                )
        for name, node in plate.nodes.items():
            if not isinstance(node, InferenceNode) or not node.belief or not node.belief.gaussian:
                continue
            if kind in joined:
                keep = setting("--keep-beliefs")
                raise UnkeptBeliefError(
                    f"{keep}: {kind}.{name} is Gaussian and joined with others, which is not smoothed yet; "
                    f"allowed: belief: particles, or no {keep}"
                )


class BeliefWriter(LineFile):
    """``beliefs.jsonl``: a new file, or one that is continued."""

    def write(
        self, frame: int, target: str, state: TargetState, messages: AgentMessages | None = None
    ) -> None:
        """Add the belief of one target in one frame, and what its agents said, to the next flush."""
        context = state.motion_context
        line = {"frame": frame, "target": target, "time": state.time, **_posterior_to_plain(state.belief)}
        if context is not None and context.influences is not None:
            line["influences"] = _influences_to_plain(context.influences)
        if messages is not None:
            line |= _heard_to_plain(messages)
        self.append(json.dumps(line, separators=(",", ":")))


def read_beliefs(path: Path) -> Iterator[KeptBelief]:
    """The lines of ``beliefs.jsonl``; a torn last line, as a killed run leaves it, is left out.

    Raises:
        JournalError: another line is damaged; says which.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                yield _kept(json.loads(line))
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
                raise JournalError(f"{path}:{number}: not a belief ({error}): {short(repr(line))}") from error


def _posterior_to_plain(posterior: Posterior) -> dict[str, Any]:
    if isinstance(posterior, ModalPosterior):
        parts = [_posterior_to_plain(part) for part in posterior.parts]
        return {"modes": _to_text(posterior.mode_probabilities, "<f8"), "parts": parts}
    if isinstance(posterior, GaussianPosterior):
        return {
            "gaussian": list(posterior.fields),
            "mean": _to_text(posterior.mean, "<f8"),
            "covariance": _to_text(posterior.covariance, "<f8"),
            "size": posterior.size,
        }
    if isinstance(posterior, GridBelief):
        posterior = _heaviest_cells(posterior)
    if not isinstance(posterior, ParticleSet):
        raise TypeError(f"a {type(posterior).__name__} cannot be kept")
    return {
        "particles": list(posterior.fields),
        "states": _to_text(posterior.states, "<f4"),
        "log_weights": _to_text(posterior.weights.log, "<f4"),
    }


def _heaviest_cells(grid: GridBelief) -> ParticleSet:
    flat = grid.mass.ravel()
    cells = np.sort(np.argsort(flat)[-MOST_CELLS:])
    cells = cells[flat[cells] > 0]
    indices = np.unravel_index(cells, grid.mass.shape)
    columns = [values[indices[AXIS[name]]] for values, name in zip(grid.values, grid.fields, strict=True)]
    return ParticleSet(np.stack(columns, axis=1), grid.fields, LogWeights.normalise(np.log(flat[cells]))[0])


def _influences_to_plain(influences: Influences) -> dict[str, Any]:
    plain: dict[str, Any] = {"dt": influences.dt, "first_size": influences.first_size.tolist()}
    if influences.inflation != 1.0:
        plain["inflation"] = influences.inflation
    if influences.camera is not None:
        plain["camera"] = [*influences.camera.linear.ravel().tolist(), *influences.camera.offset.tolist()]
    if influences.jump_share:
        plain["jump_share"] = influences.jump_share
    return plain


def _heard_to_plain(messages: AgentMessages) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    if messages.log_likelihoods:
        answers = messages.log_likelihoods.items()
        plain["log_likelihoods"] = {agent: _to_text(values, "<f4") for agent, values in answers}
    if messages.measured:
        plain["measured"] = {
            agent: {
                "fields": list(measurement.fields),
                "mean": _to_text(measurement.mean, "<f8"),
                "covariance": _to_text(measurement.covariance, "<f8"),
            }
            for agent, measurement in messages.measured.items()
        }
    return plain


def _kept(line: dict[str, Any]) -> KeptBelief:
    influences = line.get("influences")
    posterior = _posterior(line)
    return KeptBelief(
        int(line["frame"]),
        str(line["target"]),
        float(line["time"]),
        posterior,
        None if influences is None else _influences(influences),
        _heard(line, posterior),
    )


def _heard(line: dict[str, Any], posterior: KeptPosterior) -> AgentMessages:
    answers = {str(a): _from_text(text, "<f4") for a, text in line.get("log_likelihoods", {}).items()}
    for agent, values in answers.items():
        if not isinstance(posterior, ParticleSet) or len(values) != len(posterior):
            raise ValueError(f"{len(values)} log-likelihoods of {agent} for {len(posterior)} particles")
    return AgentMessages(
        answers, {str(a): _measured(text_of) for a, text_of in line.get("measured", {}).items()}
    )


def _measured(plain: dict[str, Any]) -> Measurement:
    fields = tuple(map(str, plain["fields"]))
    mean, covariance = (_from_text(plain[key], "<f8") for key in ("mean", "covariance"))
    return Measurement(fields, mean, covariance.reshape(len(fields), len(fields)))


def _posterior(line: dict[str, Any]) -> KeptPosterior:
    if "modes" in line:
        shares = _from_text(line["modes"], "<f8")
        parts = tuple(
            part for plain in line["parts"] if isinstance(part := _posterior(plain), GaussianPosterior)
        )
        if len(parts) != len(shares):
            raise ValueError(f"{len(parts)} Gaussians and {len(shares)} modes")
        return ModalPosterior(parts, shares)
    if "gaussian" in line:
        fields = tuple(line["gaussian"])
        mean, covariance = (_from_text(line[key], "<f8") for key in ("mean", "covariance"))
        return GaussianPosterior(mean, covariance.reshape(len(mean), len(mean)), fields, int(line["size"]))
    fields = tuple(line["particles"])
    states = _from_text(line["states"], "<f4").reshape(-1, len(fields))
    log = _from_text(line["log_weights"], "<f4")
    if len(log) != len(states):
        raise ValueError(f"{len(states)} states and {len(log)} weights")
    return ParticleSet(states, fields, LogWeights.normalise(log)[0])


def _influences(plain: dict[str, Any]) -> Influences:
    camera = plain.get("camera")
    shift = None
    if camera is not None:
        numbers = np.array(camera, dtype=np.float64)
        shift = CameraShift(numbers[:4].reshape(2, 2), numbers[4:6])
    return Influences(
        float(plain["dt"]),
        np.array(plain["first_size"], dtype=np.float64),
        float(plain.get("inflation", 1.0)),
        shift,
        float(plain.get("jump_share", 0.0)),
    )


def _to_text(values: Floats, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode("ascii")


def _from_text(text: str, dtype: str) -> Floats:
    values = np.frombuffer(base64.b64decode(text, validate=True), dtype=dtype).astype(np.float64)
    if np.isnan(values).any():
        raise ValueError("not a number among the values")
    return values

"""Smooth a finished run: every frame's belief given the whole sequence, without its video."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from bayesnet_track.adapt.identities import LEAST_DOUBT
from bayesnet_track.belief.asked import groups_of
from bayesnet_track.belief.contract import MotionModel, Posterior
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.belief.motion.borders import NOTHING, confined
from bayesnet_track.belief.motion.composed import compose_motion, deviations_of
from bayesnet_track.belief.motion.jumps import Jumping, Search
from bayesnet_track.belief.motion.modes import mode_probabilities, modes_of
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.smoothing import (
    Move,
    most_probable_trajectory,
    smooth_gaussians,
    smooth_particles,
)
from bayesnet_track.engine.compiled import make_plate_motion
from bayesnet_track.engine.lifecycle.identities import SURE
from bayesnet_track.engine.metrics import CLOUD_SIZE, state_numbers
from bayesnet_track.engine.queries import AskedTargets, answer
from bayesnet_track.engine.scoring.score import blur_regions
from bayesnet_track.graph import spec
from bayesnet_track.graph.checks.plates import names_of_inputs, numbers_of_kinds
from bayesnet_track.graph.checks.queries import input_columns
from bayesnet_track.inference.queries import compile_query
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics, numbers_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.settings import setting
from bayesnet_track.observation.timed_columns import values_at
from bayesnet_track.runtime.recording.beliefs import KeptBelief, KeptPosterior, read_beliefs
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.resizing import Resizing


class KeptBeliefsError(ValueError):
    """A run whose beliefs were not kept, or are not those of its journal."""


def kept_lifetimes(run: Run) -> Iterator[list[KeptBelief]]:
    """The beliefs of each target between its start and its end; one that returns begins anew.

    Raises:
        KeptBeliefsError: the run kept no beliefs, or has been smoothed, or one is of an unknown target, or
            those of the last frames of a finished run are missing.
        JournalError: beliefs.jsonl is damaged.
    """
    if run.started.smoothed:
        raise KeptBeliefsError(f"{run.name}: it has been smoothed; use the run that it was made from")
    if not run.directory.beliefs.is_file():
        raise KeptBeliefsError(
            f"{run.name}: it kept no beliefs; run it again with `{setting('--keep-beliefs')}`"
        )
    starts = TargetStarted | Returned
    births = {(event.target, event.frame) for event in run.events if isinstance(event, starts)}
    open_lives: dict[str, list[KeptBelief]] = {}
    last_frames: dict[str, int] = {}
    for belief in read_beliefs(run.directory.beliefs):
        if belief.target not in run.kinds:
            raise KeptBeliefsError(
                f"{run.directory.beliefs}: target {belief.target!r} never starts in the journal"
            )
        last_frames[belief.target] = belief.frame
        life = open_lives.get(belief.target)
        if life is None or (belief.target, belief.frame) in births:
            if life is not None:
                yield life
            open_lives[belief.target] = [belief]
        else:
            life.append(belief)
    if isinstance(run.events[-1], RunEnded):
        _check_whole(run, last_frames)
    yield from open_lives.values()


def _check_whole(run: Run, last_frames: Mapping[str, int]) -> None:
    """Refuse a file that ends before its run does; `last_frames` has those of targets."""
    frames = {line.target: line.frame for line in run.metrics}
    for target, frame in frames.items():
        if last_frames.get(target, -1) < frame and not _is_start(run, target, frame):
            extent = f"frame {last_frames[target]}" if target in last_frames else "no frame"
            raise KeptBeliefsError(
                f"{run.directory.beliefs}: of target {target!r} it has {extent} last, the run frame {frame}; "
                f"it was cut short: `bayesnet-track verify {run.directory.path}` says what else has changed"
            )


def _is_start(run: Run, target: str, frame: int) -> bool:
    """True for the frame in which the target started, of which no belief is kept."""
    starts = TargetStarted | Returned
    return any(
        isinstance(event, starts) and (event.target, event.frame) == (target, frame) for event in run.events
    )


Smoothed = KeptPosterior

NO_SEARCH = Search(0.0, "", 0, np.zeros((0, 4)), np.zeros(0), 0.0, 0.0)

EXCHANGE = 0.2
"""Probability that a track goes over to another identity in a frame."""
KNOWN_PX2 = 1e-6
"""A box whose fields vary less is known: that of the frame in which the target was given."""


class SmoothingError(KeptBeliefsError):
    """A run that cannot be smoothed."""


@dataclass(frozen=True)
class SmoothedRun:
    """A run after smoothing.

    Attributes:
        events: its events; the first says that it is smoothed.
        metrics: a line per target and frame: box, sd, UD, regions and hypotheses are those of the smoothed
            beliefs, identities as they were settled, status, score and all else are the filter's.
    """

    events: tuple[Event, ...]
    metrics: tuple[FrameMetrics, ...]


def smooth(run: Run, draws: int = 50, seed: int = 0, most_probable: bool = False) -> SmoothedRun:
    """The run with every belief given the frames before and after it.

    Args:
        run: a run whose beliefs were kept.
        draws: trajectories that are drawn backward of each target with particles or a grid.
        seed: of these draws.
        most_probable: let the boxes be those of the most probable trajectory instead of the means.

    Raises:
        KeptBeliefsError: the run kept no beliefs, or has been smoothed.
        SmoothingError: targets are on the ground; or the most probable trajectory is asked for, and its
            particles were not all drawn from the motion.
        JournalError: beliefs.jsonl is damaged.
    """
    if any(target.is_ground for target in run.spec.targets.values()):
        raise SmoothingError(
            f"{run.name}: its targets are on the ground, in metres, and only boxes in the image are smoothed"
        )
    streams = Streams(seed)
    smoothed_beliefs: dict[tuple[str, int], Smoothed] = {}
    most_probable_states: dict[tuple[str, int], Floats] = {}
    for lifetime in kept_lifetimes(run):
        first = lifetime[0]
        root = _root_of(run.spec.targets[run.kinds[first.target]])
        moves = moves_of(run, lifetime)
        smoothed = _smooth_lifetime(
            run, root, lifetime, moves, draws, streams.of(first.target, "", first.frame, "smooth")
        )
        if most_probable:
            states = _most_probable(run, root, lifetime, moves)
            most_probable_states |= {
                (first.target, filtered.frame): s for filtered, s in zip(lifetime, states, strict=True)
            }
        smoothed_beliefs |= {
            (first.target, filtered.frame): belief
            for filtered, belief in zip(lifetime, smoothed, strict=True)
        }
    metrics = tuple(
        _described(
            run,
            line,
            smoothed_beliefs[line.target, line.frame],
            streams.of(line.target, "", line.frame, "cloud"),
            most_probable_states.get((line.target, line.frame)),
        )
        if (line.target, line.frame) in smoothed_beliefs
        else line
        for line in run.metrics
    )
    metrics = tuple(settle_identities([*_with_answers(run, metrics, smoothed_beliefs)]))
    events = tuple(
        replace(event, smoothed=True) if isinstance(event, RunStarted) else event for event in run.events
    )
    return SmoothedRun(events, metrics)


def _with_answers(
    run: Run, metrics: Sequence[FrameMetrics], smoothed: Mapping[tuple[str, int], Smoothed]
) -> Iterator[FrameMetrics]:
    """The lines with what the smoothed beliefs answer to queries.

    Crossings, and what reads time or inputs, stay as the filter had them.

    A target's first frame has no smoothed belief: its answers and the number of all stay there, too.
    """
    spec = run.spec
    inputs = names_of_inputs(spec.inputs)
    compiled_queries = (
        compile_query(name, query, numbers_of_kinds(spec, query.kinds), inputs)
        for name, query in spec.queries.items()
        if query.crosses is None
    )
    queries = [compiled for compiled in compiled_queries if not compiled.reads_inputs]
    modes = {kind: modes_of(_root_of(target)) for kind, target in spec.targets.items()}
    if not queries:
        yield from metrics
        return
    width, height = Resizing.of(run.started).tracked
    frame = {"frame_width": float(width), "frame_height": float(height), "dt": 1.0}
    frame["frame_s"] = run.started.frame_interval_s
    for index, group in groupby(metrics, key=lambda line: line.frame):
        lines = list(group)
        beliefs: dict[str, list[tuple[str, Posterior]]] = {kind: [] for kind in spec.targets}
        for line in lines:
            if (line.target, index) in smoothed:
                beliefs[run.kinds[line.target]].append((line.target, smoothed[line.target, index]))
        exists = {line.target: line.existence for line in lines if line.existence is not None}
        groups = {kind: groups_of(members, modes[kind]) for kind, members in beliefs.items()}
        targets = AskedTargets(groups, exists)
        answers = [answer(compiled, targets, frame) for compiled in queries]
        if any((line.target, index) not in smoothed for line in lines):
            answers = [replace(answered, total=None) for answered in answers]
        for line in lines:
            is_smoothed = (line.target, index) in smoothed
            numbers = numbers_of(answers, line.target) if is_smoothed else {}
            yield replace(line, queries={**line.queries, **numbers})


def settle_identities(lines: Sequence[FrameMetrics]) -> Iterator[FrameMetrics]:
    """The lines with identities given the whole run, by the backward pass of a hidden Markov model.

    In a frame s(u) is the filter's probability that a target is u, and b(v) that of the next frame given all:

        b'(u) = sum_v b(v) T(u, v) s(u) / sum_w T(w, v) s(w)

    A track goes over to another identity in a frame with probability `EXCHANGE` (Rabiner 1989).
    """
    following: dict[str, Mapping[str, float]] = {}
    settled: list[Mapping[str, float]] = []
    for line in reversed(lines):
        shares: Mapping[str, float] = line.identities or {line.target: 1.0}
        later = following.get(line.target, shares)
        if later != shares:
            shares = _settled(shares, later)
        following[line.target] = shares
        settled.append({} if shares.get(line.target, 0.0) >= SURE else shares)
    for line, identities in zip(lines, reversed(settled), strict=True):
        yield replace(line, identities=identities)


def _settled(shares: Mapping[str, float], later: Mapping[str, float]) -> dict[str, float]:
    """The shares of a frame, of the filter, given those of the next frame; the most probable one first."""
    changing = EXCHANGE / max(len({*shares, *later}) - 1, 1)
    posterior = dict.fromkeys(shares, 0.0)
    for name, probability in later.items():
        stays = (1.0 - EXCHANGE - changing) * shares.get(name, 0.0)
        for previous, share in shares.items():
            joint = share * (1.0 - EXCHANGE if previous == name else changing)
            posterior[previous] += probability * joint / (stays + changing)
    total = sum(posterior.values())
    ranked = sorted(posterior.items(), key=lambda item: -item[1])
    return {name: share / total for name, share in ranked if share >= LEAST_DOUBT * total}


def _most_probable(
    run: Run, root: spec.InferenceNode, lifetime: Sequence[KeptBelief], moves: Sequence[Move]
) -> Sequence[Floats]:
    """The states of the most probable trajectory; none for Gaussians, of which it is the means."""
    particles = [filtered.posterior for filtered in lifetime if isinstance(filtered.posterior, ParticleSet)]
    if any(isinstance(filtered.posterior, ModalPosterior) for filtered in lifetime):
        raise SmoothingError(
            f"{run.name}: a Gaussian in modes keeps no trajectory of modes; allowed: belief: particles, or "
            f"smooth without {setting('--map')}"
        )
    if not particles:
        return [np.empty(0)] * len(lifetime)
    settings = spec.Particles() if root.belief is None else root.belief.settings
    on_grid = isinstance(settings, spec.Grid)
    jumps = any(
        filtered.influences is not None and filtered.influences.jump_share > 0 for filtered in lifetime
    )
    if jumps or not (on_grid or (isinstance(settings, spec.Particles) and _is_plain(settings))):
        raise SmoothingError(
            f"{run.name}: its particles were not all drawn from the motion in every frame, so that their "
            "weights do not tell the most probable trajectory; allowed: particles of a fixed size with "
            "proposal: bootstrap, when: every_frame, no relocalize; grid; gaussian; or smooth without "
            f"{setting('--map')}"
        )
    return list(most_probable_trajectory(particles, moves, on_grid))


def _is_plain(settings: spec.Particles) -> bool:
    """True if every particle is drawn from the prediction, so that its weight is its likelihood."""
    is_fixed = isinstance(settings.size, int) and settings.when == "every_frame"
    return is_fixed and settings.proposal.kind == "bootstrap"


def _smooth_lifetime(
    run: Run,
    root: spec.InferenceNode,
    lifetime: Sequence[KeptBelief],
    moves: Sequence[Move],
    draws: int,
    rng: np.random.Generator,
) -> Sequence[Smoothed]:
    beliefs = [filtered.posterior for filtered in lifetime]
    gaussians = [
        posterior for posterior in beliefs if isinstance(posterior, GaussianPosterior | ModalPosterior)
    ]
    if len(gaussians) == len(beliefs):
        assert root.belief is not None and isinstance(root.belief.settings, spec.Gaussian)
        return smooth_gaussians(gaussians, moves, root.belief.settings)
    particles = [posterior for posterior in beliefs if isinstance(posterior, ParticleSet)]
    if len(particles) != len(beliefs):
        raise SmoothingError(
            f"{run.directory.beliefs}: target {lifetime[0].target!r} has beliefs of two kinds"
        )
    return smooth_particles(particles, moves, draws, rng)


def _described(
    run: Run, line: FrameMetrics, belief: Smoothed, rng: np.random.Generator, state: Floats | None = None
) -> FrameMetrics:
    """The line with what the smoothed belief says; a target's first frame, where it was given, stays."""
    if np.diagonal(belief.covariance)[:4].max() < KNOWN_PX2:
        return line
    plate = run.spec.targets[run.kinds[line.target]]
    root = _root_of(plate)
    mean = belief.mean
    variances = np.clip(np.diagonal(belief.covariance)[:4], 0.0, None).copy()
    most_probable = (
        belief.states[int(np.argmax(belief.weights.log))] if isinstance(belief, ParticleSet) else mean
    )
    centre = mean
    if state is not None and len(state):
        most_probable = centre = state
    ud = belief.uncertainty(most_probable, [belief.fields.index(name) for name in root.ud_fields])
    region50, region90 = belief.regions((0.5, 0.9))
    if root.localization_error is not None:
        side = float(np.sqrt(max(mean[2] * mean[3], 1.0)))
        wide = blur_regions(belief, root.localization_error, line.score, side)
        region50, region90 = wide.region50, wide.region90
        variances[:2] += wide.variance
    name = next(name for name, node in plate.nodes.items() if node is root)
    resizing = Resizing.of(run.started)
    described = replace(
        line,
        parts={},
        **_modes_of_line(root, belief),
        centre_box=_floats(_inside(centre[:4], resizing.tracked)),
        map=_floats(most_probable[:4]),
        sd=_floats(np.sqrt(variances)),
        state=state_numbers(belief),
        ud_px2=ud,
        ud_nodes={**line.ud_nodes, name: ud},
        region50=_floats(region50),
        region90=_floats(region90),
        cloud=tuple(map(tuple, np.rint(belief.draw(CLOUD_SIZE, rng)).astype(np.int64).tolist())),
    )
    return replace(resizing.metrics(described), parts=line.parts)


def _modes_of_line(root: spec.InferenceNode, belief: Smoothed) -> dict[str, Any]:
    """The modes of a smoothed belief as a line has them; nothing of a root without any."""
    modes = modes_of(root)
    if modes is None:
        return {}
    shares = mode_probabilities(belief, len(modes))
    hidden = {"hidden": modes.probability_hidden(shares)} if modes.can_hide else {}
    return {"modes": modes.named(shares), "category": modes.values(shares), **hidden}


def _inside(box: Floats, size: tuple[int, int]) -> Floats:
    bounds = np.array(size) - 1.0
    return np.concatenate([np.clip(box[:2], 0.0, bounds), np.clip(box[2:], 1.0, 2 * bounds + 2)])


def _floats(values: object) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())


def _root_of(plate: spec.Target) -> spec.InferenceNode:
    """The inference node without a parent."""
    (root,) = (n for n in plate.nodes.values() if isinstance(n, spec.InferenceNode) and n.parent is None)
    return root


def moves_of(run: Run, lifetime: Sequence[KeptBelief]) -> list[Move]:
    """Motion of the filter from each frame of a target's lifetime to the next."""
    plate = run.spec.targets[run.kinds[lifetime[0].target]]
    root = _root_of(plate)
    assert root.motion is not None
    plain = make_plate_motion(root, run.spec.constants, deviations_of(plate.nodes))
    size = Resizing.of(run.started).tracked
    inputs, second = input_columns(run.spec), run.started.frame_interval_s
    moves = []
    for earlier, later in pairwise(lifetime):
        times = later.time * second, earlier.time * second
        numbers = {"t": later.time, **values_at(inputs, (later.frame, earlier.frame), times)}
        moves.append(Move(motion_into(later, plain, root.motion, size, numbers), later.time - earlier.time))
    return moves


def motion_into(
    filtered: KeptBelief,
    plain: MotionModel,
    motion_setting: spec.Motion,
    size: tuple[int, int],
    inputs: Mapping[str, float] = NOTHING,
) -> MotionModel:
    """The motion from the frame before into this one, on the image of `size` (width, height)."""
    influences, motion = filtered.influences, plain
    if influences is not None:
        motion = compose_motion(plain, motion_setting.settings, influences)
        if influences.jump_share > 0:
            motion = Jumping(motion, influences.jump_share, *size, NO_SEARCH)
    return confined(motion, *size, inputs)

"""A run that is over, judged as a whole: which of its frames its guarantee lets be called tracking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayesnet_track.engine.scoring.outcome import level_afterwards, means_of
from bayesnet_track.graph.spec import Guarantee, InferenceNode, Target
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.recording.run_reader import Run


@dataclass(frozen=True)
class DriftCheck:
    """What became of a target's statuses.

    Attributes:
        target: target id.
        level: the mean score above which its frames are called tracking.
        live: frames that were called tracking during the run.
        afterwards: frames that are called so now.
        frames: frames after its first.
    """

    target: str
    level: float
    live: int
    afterwards: int
    frames: int


def judge_afterwards(run: Run) -> tuple[Run, tuple[DriftCheck, ...]]:
    """The run with the statuses that the guarantees of its graph allow now that it is over.

    A frame is tracking where the mean of its last scores is above the level for the whole run, and the target
    is not lost; else it is at most uncertain. The first frame of a target, in which it was shown, stays as it
    is, and so do targets whose type has no levels for it. As in the calibration, the level is for all frames
    of the run after the first of the target, with a score of 0 where it has ended.
    """
    lines, found = {(line.target, line.frame): line for line in run.metrics}, list[DriftCheck]()
    frames = sorted({line.frame for line in run.metrics} | run.seconds.keys())
    for target, kind in run.kinds.items():
        rule = _rule(run.spec.targets[kind])
        every = [line for line in run.metrics if line.target == target]
        own = every[1:]
        if rule is None or not rule.afterwards or not own:
            continue
        level, changed = _judge(rule, own, [frame for frame in frames if frame > every[0].frame])
        lines.update(((line.target, line.frame), line) for line in changed)
        found.append(DriftCheck(target, level, _count(own), _count(changed), len(own)))
    return replace(run, metrics=tuple(lines.values())), tuple(found)


def _rule(kind: Target) -> Guarantee | None:
    nodes = (node for node in kind.nodes.values() if isinstance(node, InferenceNode))
    return next((node.guarantee for node in nodes if node.guarantee is not None), None)


def _count(lines: Sequence[FrameMetrics]) -> int:
    return sum(line.status == "tracking" for line in lines)


def _judge(
    rule: Guarantee, own: Sequence[FrameMetrics], frames: Sequence[int]
) -> tuple[float, list[FrameMetrics]]:
    """The level for a target's `frames` after its first, and its lines by it."""
    scores = dict.fromkeys(frames, 0.0) | {line.frame: line.score for line in own}
    means = means_of(list(scores.values()), rule.frames)
    level = level_afterwards(rule.afterwards, means)
    assured = dict(zip(scores, (means > level).tolist(), strict=True))
    return level, [
        line if line.is_gone else replace(line, status="tracking" if assured[line.frame] else "uncertain")
        for line in own
    ]

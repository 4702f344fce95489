"""The planes on which an agent looks at many targets: a crop for each, or the whole frame for all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.inference.asking import Fault, score
from bayesnet_track.inference.compile import Plan
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.cue import FAULTS, Hypotheses, Reference
from bayesnet_track.observation.planes import MANY, Plane, Planes, Region


def planes_of_each(
    work: FrameContext,
    needs: Iterable[Plane],
    boxes: Floats,
    starts: Ints,
    grow: float = 0.0,
    share: bool = False,
) -> list[Planes]:
    """For each target planes that hold its boxes, each grown by `grow` of its size per side.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4), one at least.

    With `share`, the same of the whole frame for all where their crops would take as long: planes do not
    depend on where they are cut.
    """
    from bayesnet_track.numerics.kernels.box_kernels import crops_of_each

    started, frame = work.engine.clock(), work.frame
    corners = crops_of_each(boxes, starts, grow, frame.width, frame.height)
    areas = np.clip(corners[:, 2:] - corners[:, :2], 0, None).prod(axis=1)
    whole, needs = Region(0, 0, frame.width, frame.height), tuple(needs)
    if share and len(corners) > 1 and (len(corners) > MANY or 2 * areas.sum() > whole.area):
        found = [work.cache.planes(needs, whole)] * len(corners)
    else:
        found = [work.cache.planes(needs, Region(*own)) for own in corners.tolist()]
    work.charge("planes", started)
    return found


def ask_together(
    work: FrameContext,
    group: tuple[CompiledPlate, Plan, Mapping[str, Sequence[Reference]]],
    hypotheses: Hypotheses,
    starts: Ints,
) -> tuple[dict[str, Floats], dict[int, dict[str, Fault]]]:
    """Agent -> (N,) its log-likelihoods; target t -> agent -> its fault, where one fails.

    Those of target t of the group are `starts[t]` to `starts[t + 1] - 1` of the hypotheses. A group is a
    plate, the plan whose agents are asked, and what each of them remembers of each target.
    """
    compiled, plan, known = group
    messages: dict[str, Floats] = {}
    failed: dict[int, dict[str, Fault]] = {}
    for one in plan.observations:
        cue, references = compiled.cues[one.agent], known[one.agent]
        share = hasattr(cue, "log_likelihood_of_each")
        try:
            planes = planes_of_each(work, cue.needs, hypotheses.boxes, starts, share=share)
        except FAULTS:  # of planes: whose is found out where each target is asked by itself
            return {**messages, one.agent: np.zeros(len(hypotheses))}, {t: {} for t in range(len(references))}
        started = work.engine.clock()
        values, faults = score(cue, planes, hypotheses, starts, references)
        work.charge(one.agent, started)
        messages[one.agent] = values if one.temperature == 1.0 else values / one.temperature
        for t, fault in faults.items():
            failed.setdefault(t, {})[one.agent] = fault
    return messages, failed

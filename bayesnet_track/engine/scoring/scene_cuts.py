"""Cuts: found once a frame, before anything else is done in it, for all targets whose rule asks for it."""

from __future__ import annotations

from dataclasses import replace

from bayesnet_track.adapt.memory import STATUS_STREAKS
from bayesnet_track.engine.compiled import CompiledPlate, Engine
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.scoring.rivals import without_motion
from bayesnet_track.engine.scoring.score import LEAST_FRAMES
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.spec import Lost
from bayesnet_track.journal.events.statuses import SceneCut
from bayesnet_track.journal.net import apply_decisions
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.planes import Scene, compare_scenes, describe_scene


def find_cuts(engine: Engine, state: State, frame: Frame) -> tuple[State, tuple[SceneCut, ...]]:
    """The state that `frame` begins with, and whose scene was cut before it.

    A frame that shows no scene, such as a black one, is skipped: the next is compared with the one before it.
    """
    last_scene, scene = _last_scene(state), describe_scene(frame.image)
    if last_scene is None or scene is None:
        return replace(state, scene=scene or last_scene), ()
    state = replace(state, scene=scene)
    change = compare_scenes(last_scene, scene)
    cuts: dict[str, SceneCut] = {}
    for target in state.targets:
        level = cut_level(engine.plates[state.net.targets[target].template])
        if level is not None and change.distance > level:
            cuts[target] = SceneCut(
                frame.index, target, change.distance, level, change.colors, change.structure
            )
    if not cuts:
        return state, ()
    targets = {
        name: _without_place(engine, state, name, frame.index) if name in cuts else target_state
        for name, target_state in state.targets.items()
    }
    decisions = tuple(cuts.values())
    return replace(state, net=apply_decisions(state.net, decisions), targets=targets), decisions


def _rule_of(compiled: CompiledPlate) -> Lost | None:
    return compiled.plate.inference(compiled.plate.root).lost


def cut_level(compiled: CompiledPlate) -> float | None:
    """Distance of two scenes from which a cut lies between them; None where a plate asks for no cuts."""
    rule = _rule_of(compiled)
    return None if rule is None else rule.scene_cut


def _last_scene(state: State) -> Scene | None:
    """The last scene that was seen; that of the last frame where none was looked at before."""
    if state.scene is not None or state.previous is None:
        return state.scene
    return describe_scene(state.previous.image)


def _without_place(engine: Engine, state: State, target: str, frame: int) -> TargetState:
    """State of a target that may now be anywhere: it has to be recognised, best where it was last."""
    target_state = state.targets[target]
    rule = _rule_of(engine.plates[state.net.targets[target].template])
    scored, context = target_state.scored, target_state.motion_context
    if rule is not None and rule.found_fit is not None and scored.missing is None:
        is_known = len(scored.fits) >= LEAST_FRAMES
        scored = replace(scored, low=0, again=(), missing=frame if is_known else None)
    return replace(
        target_state,
        memory=target_state.memory.without([kind for kind, _ in STATUS_STREAKS]),
        motion_context=None if context is None else replace(context, held=None),
        scored=without_motion(scored),
    )

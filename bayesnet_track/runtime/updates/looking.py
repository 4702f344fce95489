"""What of a graph looks at the image."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.step import Engine
from bayesnet_track.observation.detector import GIVEN


def image_users(engine: Engine) -> tuple[str, ...]:
    """What needs the pixels of each frame, in words; nothing where given detections are all that is used."""
    return tuple(
        f"{name} of {plate}" if len(engine.plates) > 1 else name
        for plate, compiled in engine.plates.items()
        for name in _of_plate(compiled)
    )


def _of_plate(compiled: CompiledPlate) -> Iterator[str]:
    for agent, cue in compiled.cues.items():
        if cue.needs:
            yield f"agent {agent}"
    birth = compiled.plate.spec.birth
    if birth is not None and birth.detector.detector != GIVEN:
        yield f"births by {birth.detector.detector}"
    if compiled.finder is not None:
        yield "relocalize by a detector"
    if compiled.moving is not None and compiled.moving.camera is not None:
        yield "motion with camera"
    if compiled.verifiers:
        yield f"score with {', '.join(compiled.verifiers)}"
    lost = compiled.plate.inference(compiled.plate.root).lost
    if lost is not None and lost.scene_cut is not None:
        yield "lost with scene_cut"

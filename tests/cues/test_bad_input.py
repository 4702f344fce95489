"""Bad input to every cue, through the engine: a clear error, or an event, and the run goes on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track import GraphSpec, load_graph, track
from bayesnet_track.engine.starts import StartError
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.observation.planes import Frame, RightEye, StereoGeometry
from bayesnet_track.sources.paths import SourceError

WIDTH, HEIGHT, FRAMES = 96, 72, 7
GEOMETRY = StereoGeometry(300.0, 0.2, WIDTH / 2, HEIGHT / 2)
CUES = sorted(name for name, one in installed_cues().items() if not one.reads_detection)
"""Those that look at the picture."""
WITH_MODEL = sorted(name for name, one in installed_cues().items() if "model" in one.parameters.model_fields)
NEEDS_COLOR = sorted(name for name, one in installed_cues().items() if one.needs_color)


def picture(frame: int) -> np.ndarray:
    """A speckled square of 24 px that moves over a speckled background."""
    rng = np.random.default_rng(5)
    image = rng.integers(60, 140, (HEIGHT // 4, WIDTH // 4, 3), dtype=np.uint8).repeat(4, 0).repeat(4, 1)
    square = rng.integers(90, 256, (6, 6, 3), dtype=np.uint8).repeat(4, 0).repeat(4, 1) * [0.3, 0.5, 1.0]
    image[20:44, 30 + frame : 54 + frame] = square
    return image


@dataclass
class Pictures:
    """A source of given pictures, with a right eye for those who need one."""

    images: list[np.ndarray]
    has_color: bool = True
    rights: list[np.ndarray | None] = field(default_factory=list)
    has_depth: bool = True
    description: str = "pictures"
    frame_interval_s: float = 0.04
    end_reason: str = "end_of_source"

    @property
    def expected_frames(self) -> int:
        return len(self.images)

    @property
    def width(self) -> int:
        return int(self.images[0].shape[1])

    @property
    def height(self) -> int:
        return int(self.images[0].shape[0])

    def __iter__(self) -> Iterator[Frame]:
        rights = self.rights or [np.roll(image, -10, axis=1) for image in self.images]
        for index, (image, right) in enumerate(zip(self.images, rights, strict=True)):
            depth = None if right is None or not self.has_depth else RightEye(right, GEOMETRY)
            yield Frame(index, float(index), image, self.has_color, 0.04 * index, depth)


def graph(cue: str, **parameters: object) -> GraphSpec:
    """The cue as an agent that learns in every frame; beside it one that always works."""
    root = {
        "belief": {"particles": {"size": 60}},
        "motion": {"random_walk": {"sd_px": {"x": 3, "y": 3}}},
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_px2": 1e6}, "rate_max": 0.1},
    }
    nodes = {
        "target": root,
        "tested": {"parent": "target", "agent": {cue: parameters} if parameters else cue},
        "other": {"parent": "target", "agent": {"intensity": {"form": "difference"}}},
    }
    return GraphSpec.model_validate({"name": "bad", "targets": {"target": {"nodes": nodes}}})


def tracked(cue: str, source: Pictures, box: tuple[float, ...]) -> SimpleNamespace:
    """A whole run: its results, its events, why the tested agent is out (or None). All numbers are finite."""
    events: list[object] = []
    sink = SimpleNamespace(event=events.append, frame=lambda result: None)
    results = list(track(graph(cue), source, box, sinks=[sink]))
    assert [result.frame.index for result in results] == list(range(len(source.images)))
    for result in results:
        (target,) = result.targets
        assert np.isfinite([*target.centre_box, *target.sd, *target.ud_nodes.values()]).all()
        assert np.isfinite(result.covariances.get("1", np.zeros(1))).all()
    out = {event.node: event.reason for event in events if isinstance(event, Quarantined)}
    assert "other" not in out
    assert ("tested" in results[-1].targets[0].active) == ("tested" not in out)
    return SimpleNamespace(results=results, events=events, out=out.get("tested"))


def first_of(values: list[tuple[int, ...]], count: int = 1) -> list[object]:
    """`values`, of which those after the first `count` are slow: a run of every cue for each."""
    return [*values[:count], *(pytest.param(value, marks=pytest.mark.slow) for value in values[count:])]


@pytest.mark.slow
@pytest.mark.parametrize("cue", CUES)
def test_good_input_stops_nobody(cue: str) -> None:
    run = tracked(cue, Pictures([picture(frame) for frame in range(FRAMES)]), (30, 20, 24, 24))
    assert run.out is None
    x, y, _, _ = run.results[-1].targets[0].centre_box
    assert np.hypot(x - 41.5 - FRAMES + 1, y - 31.5) < 12.0


@pytest.mark.parametrize("cue", CUES)
def test_gray_video(cue: str) -> None:
    """A cue of colour is out from the first frame, and says why; the others work on."""
    gray = [cv2.cvtColor(picture(frame), cv2.COLOR_BGR2GRAY) for frame in range(FRAMES)]
    run = tracked(cue, Pictures([cv2.merge([one] * 3) for one in gray], has_color=False), (30, 20, 24, 24))
    assert run.out == ("needs colour, and the source is gray" if cue in NEEDS_COLOR else None)
    if cue in NEEDS_COLOR:
        assert "tested" not in run.results[0].targets[0].active


@pytest.mark.slow
@pytest.mark.parametrize("cue", CUES)
@pytest.mark.parametrize(
    "box", first_of([(-30, -20, 160, 120), (84, 60, 24, 24), (-12, 20, 24, 24), (0, 0, 96, 72)], 2)
)
def test_a_target_at_the_border_or_larger_than_the_frame(cue: str, box: tuple[float, ...]) -> None:
    assert tracked(cue, Pictures([picture(frame) for frame in range(FRAMES)]), box).out is None


@pytest.mark.parametrize("cue", CUES)
def test_a_target_outside_the_frame_is_refused(cue: str) -> None:
    with pytest.raises(StartError, match="outside the 96x72 frame"):
        tracked(cue, Pictures([picture(0)]), (200, 10, 24, 24))


@pytest.mark.parametrize("cue", CUES)
@pytest.mark.parametrize("box", first_of([(40, 30, 1, 1), (40, 30, 3, 1), (40, 30, 3, 3)]))
def test_a_target_of_few_pixels(cue: str, box: tuple[float, ...]) -> None:
    assert tracked(cue, Pictures([picture(frame) for frame in range(FRAMES)]), box).out is None


@pytest.mark.parametrize("cue", CUES)
@pytest.mark.parametrize("colour", first_of([(0, 0, 0), (128, 128, 128), (30, 60, 220)]))
def test_a_constant_picture(cue: str, colour: tuple[int, int, int]) -> None:
    images = [np.full((HEIGHT, WIDTH, 3), colour, np.uint8)] * FRAMES
    assert tracked(cue, Pictures(images), (30, 20, 24, 24)).out is None


@pytest.mark.parametrize("cue", CUES)
def test_a_picture_that_turns_constant(cue: str) -> None:
    images = [picture(frame) for frame in range(3)] + [np.full((HEIGHT, WIDTH, 3), 90, np.uint8)] * 4
    assert tracked(cue, Pictures(images), (30, 20, 24, 24)).out is None


@pytest.mark.parametrize("cue", CUES)
def test_one_eye(cue: str) -> None:
    """An agent that needs depth: the source is refused before the first frame, with its name."""
    source = Pictures([picture(frame) for frame in range(FRAMES)], has_depth=False)
    declaration = installed_cues()[cue]
    made = declaration.make(declaration.parameters())
    if any(getattr(plane, "needs_depth", False) for plane in made.needs):
        with pytest.raises(SourceError, match="one eye, and tested of the graph needs depth"):
            tracked(cue, source, (30, 20, 24, 24))
    else:
        assert tracked(cue, source, (30, 20, 24, 24)).out is None


@pytest.mark.parametrize("bad", ["missing", "smaller"])
def test_an_eye_that_fails_later_stops_the_agent_and_not_the_run(bad: str) -> None:
    images = [picture(frame) for frame in range(FRAMES)]
    rights: list[np.ndarray | None] = [np.roll(image, -10, axis=1) for image in images]
    rights[4] = None if bad == "missing" else rights[4][: HEIGHT // 2]
    run = tracked("stereo", Pictures(images, rights=rights), (30, 20, 24, 24))
    (event,) = (one for one in run.events if isinstance(one, Quarantined))
    assert (event.frame, event.node) == (4, "tested")
    assert {"missing": "one eye", "smaller": "does not fit a picture"}[bad] in event.reason
    assert "tested" in run.results[3].targets[0].active


@pytest.mark.parametrize("cue", WITH_MODEL)
@pytest.mark.parametrize("bad", ["missing", "no model", "of another shape"])
def test_a_model_file_that_will_not_do(cue: str, bad: str, tmp_path: Path) -> None:
    """Known at compile time: the error names the node and the file, and nothing runs."""
    file = tmp_path / "model.npz"
    if bad == "no model":
        file.write_text("not a model")
    elif bad == "of another shape":
        np.savez(file, mean=np.zeros(7), modes=np.zeros((2, 9)), variances=np.zeros(3))
    with pytest.raises(GraphError) as raised:
        load_graph(graph(cue, model=str(file)))
    assert "tested" in str(raised.value) and "model.npz" in str(raised.value)


def test_a_cue_with_a_model_file_is_among_those_tested() -> None:
    assert "shape" in WITH_MODEL and {"color_histogram", "color_blobs"} <= set(NEEDS_COLOR)

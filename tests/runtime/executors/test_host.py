"""What is asked and answered, without a process between: nothing is lost, nothing is sent twice."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from bayesnet_track.observation.cue import (
    AssociatingCue,
    Cue,
    LocallyAdaptable,
    Measurement,
    MeasuringCue,
    Turnable,
    context_of,
    installed_cues,
)
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.runtime.executors.frames import FrameRing, FrameView
from bayesnet_track.runtime.executors.messages import LEAST_BYTES, EncodedReference, Sent
from bayesnet_track.runtime.executors.placing import make_proxy as place
from bayesnet_track.runtime.executors.processes import SentFrames
from bayesnet_track.runtime.executors.worker import AgentHost

PROTOCOLS = (Cue, MeasuringCue, AssociatingCue, LocallyAdaptable, Turnable)


class Across:
    """A desk whose agents are here, with all that passes made into bytes and back."""

    def __init__(self, agent, make, parameters, is_limited=False):
        self.store = FrameRing()
        view = FrameView(self.store.descriptor)
        self.host = AgentHost(view.get, is_limited)
        self.host.assign(agent, make, parameters)
        self.sent, self.bytes, self.is_busy = Sent(), [], False

    def send_frame(self, frame):
        return self.store.put(frame)

    def ask(self, call):
        assert not self.is_busy, "a question within a question"
        self.is_busy = True
        question = self.sent.question(call)
        passed = pickle.dumps(question)
        self.bytes.append(len(passed))
        answer = pickle.loads(pickle.dumps(self.host.answer(pickle.loads(passed))))
        self.is_busy = False
        if answer.raised:
            raise RuntimeError(answer.raised)
        return self.sent.decode(answer.value) if isinstance(answer.value, EncodedReference) else answer.value


@pytest.fixture
def across(placed):
    def make(name="placed", **parameters):
        declaration = placed.cues[name]
        own = declaration.parameters(**parameters)
        desk = Across("a", declaration.make, own)
        cue = declaration.make(own)
        return cue, desk, place("a", cue, desk, SentFrames(desk))

    return make


NEED_NO_FILE = [
    name
    for name, one in installed_cues().items()
    if not any(own.is_required() for own in one.parameters.model_fields.values())
]


@pytest.mark.parametrize("name", NEED_NO_FILE)
def test_a_proxy_fulfils_the_protocols_that_its_cue_does(name):
    declaration, desk = installed_cues()[name], object()
    cue = declaration.make(declaration.parameters())
    proxy = place("a", cue, desk, SentFrames(desk))
    assert [isinstance(proxy, kind) for kind in PROTOCOLS] == [isinstance(cue, kind) for kind in PROTOCOLS]
    assert context_of(proxy) == context_of(cue)
    assert getattr(proxy, "rule", None) == getattr(cue, "rule", None)


def test_answers_are_those_of_the_cue_and_a_reference_crosses_once(placed, across):
    cue, desk, proxy = across()
    frames, hypotheses = placed.frames(3), placed.hypotheses
    references = []
    for asked in (cue, proxy):
        cache = PlaneCache(FramePair(frames[1], frames[0]))
        planes = cache.planes(asked.needs, placed.region)
        learnt = asked.learn(planes, placed.box)
        first = asked.log_likelihood(planes, hypotheses, learnt)
        assert asked.log_likelihood(planes, hypotheses, learnt).tobytes() == first.tobytes()
        mixed = asked.blend(learnt, asked.learn(planes, placed.box + 1.0), 0.25)
        references.append((learnt, mixed, {"first": first}))
    for here, there in zip(*references, strict=True):
        assert {n: v.tobytes() for n, v in here.items()} == {n: v.tobytes() for n, v in there.items()}
    assert references[1][0]["big"].nbytes > LEAST_BYTES > max(desk.bytes)
    own = {"box": np.zeros(4), "big": np.ones(1000)}
    for _ in range(2):
        proxy.blend(own, own, 0.5)
    assert desk.bytes[-2] > own["big"].nbytes > 2 * desk.bytes[-1]


@pytest.mark.parametrize("most", [20_000, 10_000])
def test_arrays_that_were_forgotten_are_sent_again(monkeypatch, across, placed, most):
    """The smaller limit is less than the arrays of one question take."""
    monkeypatch.setattr("bayesnet_track.runtime.executors.messages.MOST_BYTES", most)
    cue, _, proxy = across()
    references = [{"box": np.zeros(4), "big": np.full(1000, float(n))} for n in range(8)]
    for n in (0, 1, 2, 3, 4, 5, 6, 7, 0, 3, 7, 1):
        mixed = proxy.blend(references[n], references[-n], 0.25)
        assert np.array_equal(mixed["big"], cue.blend(references[n], references[-n], 0.25)["big"])


def test_frames_and_depth_cross_whole_whatever_their_size():
    from bayesnet_track.observation.planes import PointMap, RightEye, StereoGeometry

    rng = np.random.default_rng(1)
    store = FrameRing()
    view = FrameView(store.descriptor)
    for n, (height, width) in enumerate(
        [(20, 30), (20, 30), (40, 31), (10, 10), (40, 31), (80, 90), (20, 30)]
    ):
        image = rng.integers(0, 255, (height, width, 3), dtype=np.uint8)
        points = rng.normal(size=(height, width, 3)).astype(np.float32)
        right = RightEye(image[::-1].copy(), StereoGeometry(400.0, 0.2, 15.0, 10.0))
        depth = (None, PointMap(points), right)[n % 3]
        frame = Frame(n, n + 0.5, image, n % 2 == 0, n / 25, depth)
        shared = pickle.loads(pickle.dumps(store.put(frame)))
        assert store.put(frame).number == shared.number
        there = view.get(shared)
        assert view.get(shared) is there
        assert (there.index, there.time, there.time_s, there.has_color) == (n, n + 0.5, n / 25, n % 2 == 0)
        assert there.image.tobytes() == image.tobytes() and there.image.shape == image.shape
        if isinstance(depth, PointMap):
            assert there.depth.points.tobytes() == points.tobytes()
        elif depth is not None:
            assert there.depth.image.tobytes() == right.image.tobytes()
            assert there.depth.geometry == right.geometry
        else:
            assert there.depth is None
    store.close()


SAID = {
    "raise": ("ValueError", "no good in frame 3"),
    "own error": ("OwnError", "of my own"),
    "mute": ("MuteError", "(without a text: its __str__ raised RuntimeError)"),
    "leave": ("SystemExit", "3"),
}
NO_NUMBERS = {
    "words": "array of <U4",
    "complex": "array of complex128",
    "masked": "masked array",
    "objects": "array of object",
}


@pytest.mark.parametrize("how", SAID)
def test_what_a_cue_raises_is_told_by_name_and_text(placed, across, how):
    _, _, proxy = across(how=how)
    planes = PlaneCache(FramePair(placed.frames(4)[3], None)).planes(proxy.needs, Region(0, 0, 9, 9))
    with pytest.raises(RuntimeError) as raised:
        proxy.log_likelihood(planes, placed.hypotheses, {"big": np.ones(9)})
    assert raised.value.args[0] == SAID[how]


@pytest.mark.parametrize("how", NO_NUMBERS)
def test_what_is_no_real_number_is_told_by_its_type(placed, across, how):
    _, _, proxy = across(how=how)
    planes = PlaneCache(FramePair(placed.frames(4)[3], None)).planes(proxy.needs, Region(0, 0, 9, 9))
    answer = proxy.log_likelihood(planes, placed.hypotheses, {"big": np.ones(9)})
    assert answer.type_name == NO_NUMBERS[how]


def test_only_a_measurement_is_one(placed, across):
    _, _, proxy = across("placed_measurer", how="stranger")
    weights = np.array([0.25, 0.75])
    for frame, kind in ((placed.frames(3)[2], Measurement), (placed.frames(4)[3], None)):
        planes = PlaneCache(FramePair(frame, None)).planes(proxy.needs, placed.region)
        answer = proxy.measure(planes, placed.hypotheses, weights, {"box": placed.box})
        if kind is None:
            assert answer.type_name == "SimpleNamespace"
        else:
            assert answer.mean.tolist() == (weights @ placed.hypotheses.boxes[:, :2]).tolist()
    assert proxy.adapt({"box": placed.box}, 2) is None
    assert isinstance(proxy.adapt({"box": placed.box}, 1), dict)

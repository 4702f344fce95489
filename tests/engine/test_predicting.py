"""The motion of one frame in the engine: plain where nothing is asked; jumps told; faults contained."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from bayesnet_track.belief.motion.composed import Nested, turning
from bayesnet_track.belief.motion.delayed import Attached, ShiftedMotion
from bayesnet_track.belief.motion.jumps import Jumping
from bayesnet_track.engine.predicting import MotionContext, predict_motion, start_motion_context
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

BOX = np.array([60.0, 50.0, 20.0, 10.0])
WALK = {"sd_px": {"x": 2.0, "y": 2.0}, "sd_log": {"scale": 0.05}}


def nodes_of(**settings):
    return {
        "root": {"motion": {"random_walk": {**WALK, **settings}}, "belief": {"particles": {"size": 300}}},
        "eye": "root",
    }


def machine_of(fakes, **settings):
    return fakes.engine(nodes_of(**settings), {"eye": fakes.flat()})[0].plates["plate"]


def orange_at(x, y):
    """A gray picture with an orange square of 20 px around (x, y)."""
    image = np.full((100, 120, 3), 128, np.uint8)
    image[y - 10 : y + 10, x - 10 : x + 10] = (0, 128, 255)
    return image


def test_a_plain_motion_is_the_plates_own(fakes):
    compiled = machine_of(fakes)
    cache = PlaneCache(FramePair(fakes.frame(1), fakes.frame(0)))
    assert compiled.moving is None
    assert start_motion_context(compiled, BOX, cache.frames) is None
    assert predict_motion(compiled, None, None, False, 1.0, cache).motion is compiled.motion


def test_what_depends_on_the_last_frame_is_arrays_and_numbers(fakes):
    compiled = machine_of(fakes, relocalize={"by": {"detector": "color_backprojection"}})
    found = start_motion_context(compiled, BOX, FramePair(Frame(0, 0.0, orange_at(60, 50)), None))
    for item in fields(MotionContext):
        value = getattr(found, item.name)
        held = value.values() if item.name == "finder" else [value]
        assert all(one is None or isinstance(one, (float, np.ndarray)) for one in held), item.name


@pytest.mark.parametrize(
    ("ud", "is_lost", "share"), [(0.0, False, 0.0), (150.0, False, 0.1), (0.0, True, 0.1)]
)
def test_it_jumps_while_unsure_or_lost(fakes, ud, is_lost, share):
    compiled = machine_of(fakes, relocalize={"by": "uniform", "above": {"ud_box": 0.5}})
    cache = PlaneCache(FramePair(fakes.frame(2), fakes.frame(0)))
    known = replace(start_motion_context(compiled, BOX, cache.frames), ud_px2=ud)
    motion = predict_motion(compiled, None, known, is_lost, 2.0, cache).motion
    if share == 0.0:
        assert motion is compiled.motion
    else:
        assert isinstance(motion, Jumping)
        assert motion.share == pytest.approx(1 - (1 - share) ** 2)
        carried = Attached(compiled.motion, np.zeros(2), 0.1, 0.9, 1.0)
        own = predict_motion(compiled, carried, known, is_lost, 2.0, cache).motion
        assert isinstance(own, Attached)
        assert isinstance(own.motion, Jumping)


def test_the_search_grows_from_where_it_was_held_while_lost_only(fakes):
    compiled = machine_of(fakes, relocalize={"by": "uniform", "grow_box": 0.5})
    cache = PlaneCache(FramePair(fakes.frame(2), fakes.frame(0)))
    width, height = cache.frames.current.width, cache.frames.current.height
    known = replace(start_motion_context(compiled, BOX, cache.frames), ud_px2=1e6)
    assert predict_motion(compiled, None, known, False, 1.0, cache).motion is compiled.motion
    found = predict_motion(compiled, None, known, True, 1.0, cache)
    assert found.motion.within is None  # never held: anywhere
    held = replace(found, motion_context=found.after(0.0, 200.0, None, BOX))
    for frame, context in enumerate((held.motion_context,) * 2):
        for _ in range(frame):
            context = predict_motion(compiled, None, context, True, 3.0, cache).after(0.0, 200.0, None)
        place = predict_motion(compiled, None, context, True, 1.0, cache).motion.evenly()
        half = 0.5 * np.sqrt(200.0) * (1 + 3 * frame)
        np.testing.assert_allclose(place.low[0], np.maximum(BOX[:2] - half, 0.0))
        np.testing.assert_allclose(place.high[0], np.minimum(BOX[:2] + half, [width - 1, height - 1]))
    old = replace(held.motion_context, away=1e3)
    whole = predict_motion(compiled, None, old, True, 1.0, cache).motion
    assert whole.area == (width - 1) * (height - 1)


def test_the_camera_carries_the_states(fakes):
    rng = np.random.default_rng(2)
    ground = np.kron(rng.integers(0, 256, (60, 60)), np.ones((5, 5))).astype(np.uint8)
    views = [
        Frame(n, float(n), np.dstack([ground[20:220, 20 + at : 260 + at]] * 3)) for n, at in ((0, 0), (1, 4))
    ]
    compiled = machine_of(fakes, camera="compensate")
    known = start_motion_context(compiled, BOX, FramePair(views[0], None))
    motion = predict_motion(
        compiled, None, known, False, 1.0, PlaneCache(FramePair(views[1], views[0]))
    ).motion
    assert isinstance(motion, ShiftedMotion)
    np.testing.assert_allclose(motion.drift(BOX[None], 1.0)[0], BOX - [4, 0, 0, 0], atol=0.1)


def test_an_angle_is_beside_all_of_it(fakes):
    """What the camera, the size and doubt say of the rest leaves the angle alone, and jumps keep it."""
    rng = np.random.default_rng(2)
    ground = np.kron(rng.integers(0, 256, (60, 60)), np.ones((5, 5))).astype(np.uint8)
    views = [
        Frame(n, float(n), np.dstack([ground[20:220, 20 + at : 260 + at]] * 3)) for n, at in ((0, 0), (1, 4))
    ]
    plain = machine_of(
        fakes, camera="compensate", size_reversion={"sd_scale": 0.3}, inflate={}, relocalize={"by": "uniform"}
    )
    compiled = replace(plain, motion=turning(plain.motion, 6.0))
    known = start_motion_context(compiled, BOX, FramePair(views[0], None))
    motion = predict_motion(
        compiled, None, known, True, 1.0, PlaneCache(FramePair(views[1], views[0]))
    ).motion
    assert motion.fields == compiled.motion.fields
    assert isinstance(motion, Jumping) and isinstance(motion.motion, Nested)
    old = np.append(BOX, 40.0)[None]
    np.testing.assert_allclose(motion.drift(old, 1.0)[0], [*(BOX - [4, 0, 0, 0]), 40.0], atol=0.1)


def test_the_detector_is_shown_the_target_and_looks_for_it(fakes):
    compiled = machine_of(fakes, relocalize={"by": {"detector": "color_backprojection"}})
    start = Frame(0, 0.0, orange_at(60, 50))
    known = start_motion_context(compiled, np.array([60.0, 50.0, 20.0, 20.0]), FramePair(start, None))
    now = PlaneCache(FramePair(Frame(1, 1.0, orange_at(100, 30)), start))
    found = predict_motion(compiled, None, known, True, 1.0, now)
    np.testing.assert_allclose(found.motion.search.boxes, [[99.5, 29.5, 20, 20]], atol=2.0)
    assert found.events == ()


class MuteError(Exception):
    def __str__(self):
        raise TypeError("nor does this")


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (RuntimeError("no"), "RuntimeError: no"),
        (SystemExit(3), "SystemExit: 3"),
        (MuteError(), "MuteError: (without a text: its __str__ raised TypeError)"),
    ],
)
def test_a_detector_that_fails_is_out_and_told(fakes, error, reason):
    class Broken:
        def start(self):
            return {}

        def detect(self, frames, state):
            raise error

    compiled = replace(machine_of(fakes, relocalize={"by": "uniform"}), finder=Broken())
    cache = PlaneCache(FramePair(fakes.frame(1), fakes.frame(0)))
    found = predict_motion(
        compiled, None, start_motion_context(compiled, BOX, cache.frames), True, 1.0, cache
    )
    assert isinstance(found.motion, Jumping)
    assert (
        found.motion_context.finder is not None and found.motion_context.fault.until == found.events[0].until
    )
    assert [event.reason for event in found.events] == [reason]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (Detections(np.array([[9.0, 9.0, 0.0, 5.0]]), np.ones(1), ("",)), "boxes without area"),
        (Detections(np.array([[9.0, 9.0, 5.0, 5.0]]), np.ones(1), ()), "0 labels"),
        (Detections(np.array([[9.0, 9.0, 5.0, 5.0]]), np.ones((1, 1)), ("",)), "scores of shape"),
        (Detections(np.array([[np.nan, 9.0, 5.0, 5.0]]), np.ones(1), ("",)), "not finite"),
        (Detections(np.full((1, 4), 9.0 + 1j), np.ones(1), ("",)), "boxes of type array of complex128"),
        (Detections(np.full((1, 4), "9"), np.ones(1), ("",)), "boxes of type array of <U1"),
        (Detections(np.full((1, 4), 9.0), np.ma.masked_less([1.0], 0.0), ("",)), "scores of type masked"),
    ],
)
def test_the_answer_of_a_detector_is_checked_as_where_targets_are_born(fakes, answer, reason):
    class Wrong:
        def start(self):
            return {}

        def detect(self, frames, state):
            return answer, state

    compiled = replace(machine_of(fakes, relocalize={"by": "uniform"}), finder=Wrong())
    cache = PlaneCache(FramePair(fakes.frame(1), fakes.frame(0)))
    found = predict_motion(
        compiled, None, start_motion_context(compiled, BOX, cache.frames), True, 1.0, cache
    )
    assert [reason in event.reason for event in found.events] == [True]


@pytest.mark.parametrize("by", ["agents", "uniform"])
def test_a_target_that_leaps_is_found_again_and_that_is_told(fakes, by):
    place = {"at": (60.0, 50.0)}

    def see(planes, hypotheses, reference):
        away = (hypotheses.boxes[:, :2] - place["at"]) / 3.0
        return np.logaddexp(-0.5 * np.sum(away**2, axis=1), np.log(1e-4))

    def run(**settings):
        engine = fakes.engine(nodes_of(**settings), {"eye": see})[0]
        place["at"] = (60.0, 50.0)
        outcomes = fakes.play(engine, 3, {"1": tuple(BOX)})
        from bayesnet_track.engine.step import step

        place["at"] = (105.0, 85.0)
        for index in range(4, 14):
            outcomes.append(step(engine, outcomes[-1].state, fakes.frame(index)))
        return outcomes

    found = run(relocalize={"by": by, "above": {"ud_box": 0.2}})
    reappeared = [event for outcome in found for event in outcome.events if isinstance(event, Reappeared)]
    assert len(reappeared) == 1
    assert reappeared[0].by == by
    assert np.hypot(found[-1].metrics[0].centre_box[0] - 105, found[-1].metrics[0].centre_box[1] - 85) < 3
    without = run()[-1].metrics[0].centre_box
    assert np.hypot(without[0] - 105, without[1] - 85) > 20


REFUSED = [
    ({"size_reversion": {}}, {}, "size_reversion without an sd"),
    ({"size_reversion": {"sd_scale": 0.05}}, {}, "sd_scale is 0.05, and the step, sd_log.scale, is 0.05"),
    ({"size_reversion": {"sd_aspect": 0.5}}, {}, "sd_aspect is 0.5, and the step, sd_log.aspect, is 0"),
    (
        {"size_reversion": {"sd_scale": 0.5}, "sd_px": {"x": 1.0, "y": 1.0, "w": 1.0}},
        {},
        "size_reversion beside sd_px.w",
    ),
    ({"camera": "compensate"}, {"belief": "grid"}, "camera beside a grid"),
    ({"size_reversion": {"sd_scale": 0.5}}, {"belief": "grid"}, "size_reversion beside a grid"),
    ({"relocalize": {}}, {"belief": {"gaussian": {"filter": "extended"}}}, "relocalize beside gaussian"),
    (
        {"relocalize": {}},
        {"belief": {"particles": {"proposal": "iterated"}}},
        "relocalize beside proposal: iterated",
    ),
    (
        {"relocalize": {}},
        {"belief": {"particles": {"size": {"kld": {"bin_px": 9}}}}},
        "relocalize beside an adaptive size",
    ),
    ({"relocalize": {}, "sd_px": {"x": 1.0}}, {}, "relocalize without noise of y"),
    ({"relocalize": {"grow_box": 1, "usual": 0.1}}, {}, "usual beside grow_box"),
    ({"relocalize": {"grow_box": 1, "above": {"ud_box": 1}}}, {}, "above beside grow_box"),
    ({"relocalize": {"sudden": {}}}, {}, "sudden without lost.found_fit"),
    ({"relocalize": {"by": {"detector": "mottion"}}}, {}, "unknown detector 'mottion'"),
    ({"relocalize": {"by": {"detector": {"motion": {"no": 1}}}}}, {}, "unknown key 'no'"),
]


@pytest.mark.parametrize(("settings", "root", "message"), REFUSED)
def test_what_cannot_act_is_refused(fakes, settings, root, message):
    nodes = nodes_of(**settings)
    nodes["root"] |= root
    with pytest.raises(GraphError, match=message):
        fakes.graph(nodes, {"eye": fakes.declare(None, name="eye")})


@pytest.mark.parametrize(
    ("belief", "settings"),
    [
        (
            {"gaussian": {"filter": "kalman"}},
            {"camera": "compensate", "inflate": {"above": {"ud_box": 0.01}}},
        ),
        (
            {"gaussian": {"filter": "unscented"}},
            {"camera": "compensate", "size_reversion": {"sd_scale": 0.3}},
        ),
        ({"grid": {"cell_px": 2}}, {"inflate": {"above": {"ud_box": 0.01}}}),
        (
            {"particles": {"size": {"kld": {"bin_px": 5}}}},
            {"inflate": {}, "size_reversion": {"sd_scale": 0.3}},
        ),
    ],
    ids=["kalman", "unscented", "grid", "kld"],
)
def test_every_belief_takes_what_the_checks_let_pass(fakes, belief, settings):
    nodes = nodes_of(**settings)
    nodes["root"]["belief"] = belief
    if "size_reversion" not in settings:
        nodes["root"]["motion"]["random_walk"].pop("sd_log")
    seen = fakes.gaussian(62.0, 52.0, 3.0, floor=1e-3)
    end = fakes.play(fakes.engine(nodes, {"eye": seen})[0], 5, {"1": tuple(BOX)})[-1].metrics[0]
    np.testing.assert_allclose(end.centre_box[:2], [62, 52], atol=2.0)

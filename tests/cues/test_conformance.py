"""What every installed cue keeps to, whoever wrote it."""

import io
import subprocess
import sys
from collections.abc import Mapping

import cv2
import numpy as np
import pytest

from bayesnet_track.inference.asking import follow, score
from bayesnet_track.observation.cue import Cue, Hypotheses, NoParameters, context_of
from bayesnet_track.observation.cue_files import file_of
from bayesnet_track.observation.planes import PlaneCache, Region, region_of_boxes


def first_of(values):
    """`values`, of which those after the first are slow: every cue is asked for each."""
    return [values[0], *(pytest.param(value, marks=pytest.mark.slow) for value in values[1:])]


def check_values(asked, values, size):
    floor = np.log(asked.cue.parameters.floor if hasattr(asked.cue, "parameters") else 1e-300)
    assert values.shape == (size,)
    assert values.dtype == np.float64
    assert np.isfinite(values).all()
    assert (values <= 0).all()
    assert (values >= floor - 1e-9).all()


def random_boxes(scene, size=300, seed=3):
    rng = np.random.default_rng(seed)
    centre = rng.uniform([-60, -60], [scene.width + 60, scene.height + 60], (size, 2))
    return np.concatenate([centre, rng.uniform(1, 150, (size, 2))], axis=1)


def test_declaration(asked):
    declaration = asked.declaration
    assert isinstance(asked.cue, Cue)
    assert declaration.summary or file_of(declaration) is not None
    assert declaration.cost_ms > 0
    assert issubclass(declaration.parameters, NoParameters)
    for name, field in declaration.parameters.model_fields.items():
        assert field.description, name
    with pytest.raises(ValueError, match="no_such_key"):
        declaration.parameters(no_such_key=1)


def test_declarations_import_nothing_heavy():
    code = (
        "import sys; from bayesnet_track.observation.cue import installed_cues; assert installed_cues(); "
        "print(*{'numba', 'cv2', 'scipy', 'av', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_planes_are_values(asked):
    again = asked.declaration.make(asked.declaration.parameters())
    assert again.needs == asked.cue.needs
    assert hash(again.needs) == hash(asked.cue.needs)


def test_learns_from_no_more_than_its_context(asked, scene):
    """The same reference, bit for bit, from the context that it asks for and from the whole frame."""
    pair, context = scene.pair(), context_of(asked.cue)
    for box in (scene.box(), scene.box((0.37, -0.81)), np.array([20.0, 230.0, 61.3, 44.9])):
        near = asked.planes(pair, region_of_boxes(box[None], context))
        wide = asked.planes(pair, Region(0, 0, scene.width, scene.height))
        one, other = asked.cue.learn(near, box), asked.cue.learn(wide, box)
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_values_are_bounded(asked, scene):
    pair = scene.pair()
    boxes = random_boxes(scene)
    check_values(asked, asked.score(pair, boxes, asked.learn(pair, scene.box())), len(boxes))


def test_the_first_frame_has_no_previous_one(asked, scene):
    pair = scene.pair()
    first = type(pair)(pair.current, None)
    reference = asked.learn(first, scene.box())
    boxes = scene.around(scene.start)
    check_values(asked, asked.score(first, boxes, reference), len(boxes))
    check_values(asked, asked.score(pair, boxes, reference), len(boxes))


def test_a_copy_scores_at_least_as_well_as_boxes_further_off(asked, scene):
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    boxes = scene.around(scene.start)
    shift = np.abs(boxes[:, :2] - scene.start) / scene.size
    copy = asked.score(pair, scene.box()[None], reference)[0]
    assert asked.score(pair, boxes[shift.max(axis=1) > 0.25], reference).max() <= copy + 1e-9


@pytest.mark.parametrize("shift", first_of([(32, -16), (-40, 24)]))
def test_the_peak_moves_with_the_target(asked, scene, shift):
    reference = asked.learn(scene.pair(), scene.box())
    moved = scene.pair(shift)
    boxes = scene.around(scene.start + np.array(shift) / 2, reach=48)
    values = asked.score(moved, boxes, reference)
    peak = boxes[values >= values.max() - 1e-12, :2].mean(axis=0)  # a plateau's middle
    assert (np.abs(peak - scene.start - shift) <= 0.25 * scene.size).all()
    here, before = asked.score(moved, np.stack([scene.box(shift), scene.box()]), reference)
    assert here > before


def test_outside_the_frame_is_no_match(asked, scene):
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    copy = asked.score(pair, scene.box()[None], reference)[0]
    boxes = np.array(
        [
            [-100.0, -100.0, *scene.size],
            [scene.width + 500.0, 50.0, *scene.size],
            [0.0, 0.0, *scene.size],
            [scene.width - 1.0, scene.height / 2, *scene.size],
        ]
    )
    values = asked.score(pair, boxes, reference)
    check_values(asked, values, 4)
    assert (values[2:] < copy - 1.0).all()
    assert (values[:2] <= np.log(0.05)).all()
    alone = asked.score(pair, boxes[:1], reference)  # the region is empty then
    assert alone[0] == values[0]


@pytest.mark.parametrize("size", first_of([(1.0, 1.0), (3.0, 1.0), (3.0, 3.0)]))
def test_tiny_targets(asked, scene, size):
    pair = scene.pair()
    box = np.array([*scene.start, *size])
    boxes = scene.around(scene.start, reach=6, step=1)
    boxes[:, 2:] = size
    check_values(asked, asked.score(pair, boxes, asked.learn(pair, box)), len(boxes))


@pytest.mark.parametrize("box", first_of([[160.0, 120, 400, 300], [5, 5, 40, 40], [-100, -100, 20, 20]]))
def test_targets_at_and_beyond_the_border(asked, scene, box):
    pair = scene.pair()
    reference = asked.learn(pair, np.array(box))
    boxes = random_boxes(scene)
    check_values(asked, asked.score(pair, boxes, reference), len(boxes))


@pytest.mark.parametrize("value", first_of([0, 128, 255]))
def test_constant_pictures(asked, scene, value):
    image = np.full((scene.height, scene.width, 3), value, np.uint8)
    pair = scene.pair_of(image, image)
    boxes = scene.around(scene.start)
    check_values(asked, asked.score(pair, boxes, asked.learn(pair, scene.box())), len(boxes))


def test_gray_pictures(asked, scene):
    images = [
        cv2.cvtColor(cv2.cvtColor(f.image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        for f in (scene.pair().current, scene.pair().previous)
    ]
    pair = scene.pair_of(*images, has_color=False)
    boxes = scene.around(scene.start)
    values = asked.score(pair, boxes, asked.learn(pair, scene.box()))
    check_values(asked, values, len(boxes))
    if asked.declaration.needs_color:
        assert np.ptp(values) == 0  # blind: says nothing for or against


def test_what_else_is_computed_changes_no_bit(asked, scene):
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    boxes = scene.around(scene.start, reach=30, step=3) + 0.37
    tight = asked.score(pair, boxes, reference)
    odd = region_of_boxes(boxes).grown(7)
    for region in (odd, Region(0, 0, scene.width, scene.height), Region(-50, -50, 900, 900)):
        assert np.array_equal(tight, asked.score(pair, boxes, reference, region))
    wide = asked.cue.learn(asked.planes(pair, Region(0, 0, scene.width, scene.height)), scene.box())
    assert all(np.array_equal(reference[name], wide[name]) for name in reference)


def test_planes_do_not_depend_on_the_region(asked, scene):
    region = Region(101, 53, 230, 187)
    for plane in asked.cue.needs:
        if plane.is_points:
            continue
        whole = PlaneCache(scene.pair()).planes([plane], Region(0, 0, scene.width, scene.height))[plane]
        part = PlaneCache(scene.pair()).planes([plane], region)[plane]
        np.testing.assert_array_equal(region.of(whole), part)  # NaN is NaN


def test_order_and_company_of_hypotheses_do_not_matter(asked, scene):
    pair = scene.pair()
    reference = asked.learn(pair, scene.box())
    boxes = random_boxes(scene)
    region = Region(0, 0, scene.width, scene.height)
    values = asked.score(pair, boxes, reference, region)
    order = np.random.default_rng(5).permutation(len(boxes))
    assert np.array_equal(values[order], asked.score(pair, boxes[order], reference, region))
    assert np.array_equal(values[:7], asked.score(pair, boxes[:7], reference, region))


def test_a_group_of_targets_gets_the_bits_of_each_alone(asked, scene):
    """Also by the cue's own form for all, with planes that they share; two are half outside the frame."""
    pair, whole = scene.pair(), Region(0, 0, scene.width, scene.height)
    border, corner = np.array([20.0, 230.0, 61.3, 44.9]), np.array([0.0, 0.0, 20.0, 20.0])
    targets = [scene.box(), scene.box((7.0, -4.0)), border, corner]
    references = [asked.learn(pair, box) for box in targets]
    clouds = [random_boxes(scene, size, seed) for seed, size in enumerate((40, 7, 60, 9))]
    starts = np.cumsum([0, *map(len, clouds)])
    shared, rates = [asked.planes(pair, whole)] * 4, np.array([0.05, 1.0, 0.3, 0.0])
    values, faults = score(asked.cue, shared, Hypotheses(np.concatenate(clouds)), starts, references)
    moved, others = follow(asked.cue, shared, np.array(targets), references, rates)
    assert not faults and not others
    for t, reference in enumerate(references):
        alone = asked.score(pair, clouds[t], reference, whole)
        assert values[starts[t] : starts[t + 1]].tobytes() == alone.tobytes()
        (own,), _ = follow(asked.cue, shared[:1], targets[t][None], [reference], rates[t : t + 1])
        assert moved[t].keys() == own.keys()
        for name in own:
            np.testing.assert_array_equal(moved[t][name], own[name], err_msg=name)


def test_threads_of_opencv_change_no_bit(asked, scene):
    pair, boxes, before = scene.pair(), scene.around(scene.start), cv2.getNumThreads()
    values = []
    try:
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            values.append(asked.score(pair, boxes, asked.learn(pair, scene.box())))
    finally:
        cv2.setNumThreads(before)
    assert np.array_equal(*values)


def test_nothing_given_is_changed(asked, scene):
    pair, box, boxes = scene.pair(), scene.box(), scene.around(scene.start)
    image, kept = pair.current.image.copy(), boxes.copy()
    reference = asked.learn(pair, box)
    copied = {name: np.array(value) for name, value in reference.items()}
    asked.score(pair, boxes, reference)
    asked.cue.blend(reference, asked.learn(pair, boxes[0]), 0.5)
    assert np.array_equal(image, pair.current.image)
    assert np.array_equal(kept, boxes)
    assert np.array_equal(box, scene.box())
    assert all(np.array_equal(copied[name], reference[name]) for name in copied)


def test_a_reference_is_stored_without_loss(asked, scene):
    pair, boxes = scene.pair(), scene.around(scene.start)
    reference = asked.learn(pair, scene.box())
    assert isinstance(reference, Mapping)
    assert all(isinstance(value, np.ndarray) for value in reference.values())
    file = io.BytesIO()
    np.savez(file, **reference)
    file.seek(0)
    with np.load(file, allow_pickle=False) as stored:
        back = dict(stored)
    assert np.array_equal(asked.score(pair, boxes, reference), asked.score(pair, boxes, back))


def test_blend_goes_from_old_to_new(asked, scene):
    pair, boxes = scene.pair(), scene.around(scene.start)
    old = asked.learn(pair, scene.box())
    new = asked.learn(pair, scene.box((14, -9)) * [1, 1, 1.25, 0.8])
    at_old, at_new = (asked.cue.blend(old, new, rate) for rate in (0.0, 1.0))
    assert old.keys() == at_old.keys()
    assert all(np.array_equal(old[name], at_old[name]) for name in old)
    assert np.allclose(asked.score(pair, boxes, at_new), asked.score(pair, boxes, new), atol=1e-6)
    between = asked.cue.blend(old, new, 0.5)
    check_values(asked, asked.score(pair, boxes, between), len(boxes))


def act_locally(asked, reference):
    """The reference after an episode of uncertainty: the cue does all that it can."""
    for attempt in range(1, 100):
        tuned = asked.cue.adapt(reference, attempt)
        if tuned is None:
            return reference
        assert tuned.keys() == reference.keys()
        reference = tuned
    pytest.fail("adapt never ran out of attempts")


def test_five_episodes_of_local_action_go_no_further_than_one(adapting, scene):
    pair, boxes = scene.pair(), scene.around(scene.start)
    learnt = adapting.learn(pair, scene.box())
    once = reference = act_locally(adapting, learnt)
    for _ in range(4):
        reference = act_locally(adapting, reference)
    tuned = adapting.score(pair, boxes, reference)
    check_values(adapting, tuned, len(boxes))
    np.testing.assert_allclose(tuned, adapting.score(pair, boxes, once), rtol=1e-9)
    assert np.abs(tuned - adapting.score(pair, boxes, learnt)).max() > 0.1  # it did something


def test_certain_frames_take_local_action_back(adapting, scene):
    pair, boxes = scene.pair(), scene.around(scene.start)
    learnt = adapting.learn(pair, scene.box())
    reference = act_locally(adapting, learnt)
    for _ in range(200):
        reference = adapting.cue.blend(reference, learnt, 0.05)
    values = adapting.score(pair, boxes, reference)
    np.testing.assert_allclose(values, adapting.score(pair, boxes, learnt), atol=1e-3)

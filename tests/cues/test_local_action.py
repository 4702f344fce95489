"""What intensity, blobs and motion do against their own uncertainty: they tell a look-alike apart."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.numerics.log_weights import factor_of, uncertainty_deviation
from bayesnet_track.observation.cue import Hypotheses, LocallyAdaptable, installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, Planes, Region

STEPS = 3
SIZE = [40.0, 40.0]
TARGET, DOUBLE = (60.0, 60.0), (180.0, 60.0)
FRAME = Region(0, 0, 240, 120)
BOX = np.array([*TARGET, *SIZE])


def hypotheses():
    """Boxes on a grid of 2 px around the target and around its look-alike."""
    offset = np.arange(-12.0, 13.0, 2.0)
    return np.array([[x + dx, y + dy, *SIZE] for x, y in (TARGET, DOUBLE) for dx in offset for dy in offset])


def placed(target, double):
    """A picture with two patches of 40 x 40 px on gray."""
    image = np.full((120, 240, 3), 110, np.uint8)
    for (x, y), patch in ((TARGET, target), (DOUBLE, double)):
        image[int(y) - 20 : int(y) + 20, int(x) - 20 : int(x) + 20] = patch
    return image


def patterns():
    """A patch of gray cells of 8 px, and the mean of it and another one."""
    rng = np.random.default_rng(3)
    own, foreign = (rng.integers(40, 216, (5, 5)) for _ in range(2))
    mixed = np.rint(0.5 * own + 0.5 * foreign)
    return [cv2.merge([np.kron(cells, np.ones((8, 8))).astype(np.uint8)] * 3) for cells in (own, mixed)]


def flags():
    """Red over blue, and the same with hues 14 degrees off."""
    upper, lower = ((0, 0, 220), (0, 50, 220)), ((220, 0, 0), (220, 0, 50))
    patches = [np.empty((40, 40, 3), np.uint8) for _ in upper]
    for patch, over, under in zip(patches, upper, lower, strict=True):
        patch[:20], patch[20:] = over, under
    return patches


def still(image):
    return FramePair(Frame(0, 0.0, image), None)


class Flow:
    """Two patches full of vectors: the target's (4, 1) px, its look-alike's (6, 1) px."""

    def planes(self, cue):
        offset = np.arange(-17.5, 20.0, 5.0)
        vectors = [
            [x + dx, y + dy, flow, 1.0]
            for (x, y), flow in ((TARGET, 4.0), (DOUBLE, 6.0))
            for dx in offset
            for dy in offset
        ]
        frame = Frame(0, 0.0, np.zeros((120, 240, 3), np.uint8))
        return Planes(frame, FRAME, {cue.flow: np.array(vectors)})


@pytest.fixture(params=["intensity", "intensity difference", "intensity coarse", "color_blobs", "motion"])
def case(request, ask):
    """The cue, its planes of the scene, and what it learnt of the target."""
    name, _, more = request.param.partition(" ")
    settings = {"difference": {"form": "difference"}, "coarse": {"grid": 20, "coarse": 5}}.get(more, {})
    asked = ask(
        name, floor=0.003, **settings
    )  # that of the library's graphs: the floor's mass stays, whatever
    if name == "motion":
        planes = Flow().planes(asked.cue)
    else:
        image = placed(*(patterns() if name == "intensity" else flags()))
        planes = asked.planes(still(image), FRAME)
    return asked.cue, planes, asked.cue.learn(planes, BOX)


def own_ud(cue, planes, reference):
    """UD of the cue's normalised likelihood about its best hypothesis, px^2, as an agent's own."""
    tried = hypotheses()
    log = cue.log_likelihood(planes, Hypotheses(tried), reference)
    weights = np.exp(log) / np.exp(log).sum()
    return uncertainty_deviation(tried[:, :2], weights, tried[log.argmax(), :2])


def tuned(cue, reference, steps=STEPS):
    for attempt in range(1, steps + 1):
        reference = cue.adapt(reference, attempt)
    return reference


def test_every_attempt_makes_it_surer_of_itself_and_the_target_keeps_its_score(case):
    cue, planes, reference = case
    at_target = Hypotheses(BOX[None])
    before = cue.log_likelihood(planes, at_target, reference)[0]
    uncertain = [own_ud(cue, planes, reference)]
    for attempt in range(1, STEPS + 1):
        reference = cue.adapt(reference, attempt)
        uncertain.append(own_ud(cue, planes, reference))
        assert cue.log_likelihood(planes, at_target, reference)[0] == pytest.approx(before, abs=1e-9)
    assert np.all(np.diff(uncertain) < 0)
    assert uncertain[-1] < 0.9 * uncertain[0]


def test_it_ends_within_an_episode_and_over_all_episodes(case):
    cue, _, reference = case
    assert cue.adapt(reference, STEPS + 1) is None
    sharpest = tuned(cue, reference)
    assert cue.adapt(sharpest, 1) is None  # the next episode cannot go further
    sharper = tuned(cue, reference, 2)
    assert tuned(cue, sharper, 1)["sharper"] == pytest.approx(float(sharpest["sharper"]))


def test_nothing_changes_unless_it_is_asked_for(case):
    """The factor is 1 to the bit at any rate of learning, and x * 1 is x."""
    cue, _, reference = case
    for rate in np.random.default_rng(0).uniform(0.0, 1.0, 200):
        assert cue.blend(reference, reference, float(rate))["sharper"] == 1.0


SHARPENING = (
    "color_blobs",
    "color_histogram",
    "color_kernel_histogram",
    "embedding",
    "foreground_color",
    "intensity",
    "motion",
    "shading",
    "stereo",
    "texture",
)


def test_these_are_all_that_sharpen():
    adaptable = {
        name
        for name, one in installed_cues().items()
        if isinstance(one.make(one.parameters()), LocallyAdaptable)
    }
    assert adaptable == {*SHARPENING, "shape"}  # shape tries other edges instead


@pytest.fixture(params=SHARPENING)
def sharpening(request, ask, scene):
    """A cue that multiplies a width or an exponent, and what it learnt."""
    asked = ask(request.param)
    return asked.cue, asked.learn(scene.pair(), scene.box())


def test_many_short_episodes_go_no_further_than_a_long_one(sharpening):
    cue, reference = sharpening
    most = factor_of(tuned(cue, reference))
    for _ in range(5):
        reference = cue.adapt(reference, 1) or reference
    assert factor_of(reference) == pytest.approx(most)
    assert cue.adapt(reference, 1) is None


def test_all_go_back_by_the_rate_of_learning_and_a_twentieth_at_most(sharpening):
    cue, reference = sharpening
    sharpest = tuned(cue, reference)
    most = factor_of(sharpest)
    for rate, share in ((0.0, 0.0), (0.02, 0.02), (0.05, 0.05), (0.3, 0.05), (1.0, 0.05)):
        back = factor_of(cue.blend(sharpest, reference, rate))
        assert back == pytest.approx(most + share * (1.0 - most)), rate


@pytest.mark.parametrize("name", ["intensity", "color_blobs", "motion"])
def test_a_cue_that_knows_nothing_of_the_target_has_nothing_to_tune(ask, name):
    """A box outside the frame, a gray target, a target without vectors."""
    asked = ask(name)
    image = np.full((120, 240, 3), 110, np.uint8)
    box = np.array([-100.0, 60.0, *SIZE]) if name == "intensity" else BOX
    planes = (
        Planes(Frame(0, 0.0, image), FRAME, {asked.cue.flow: np.empty((0, 4))})
        if name == "motion"
        else (asked.planes(still(image), FRAME))
    )
    assert asked.cue.adapt(asked.cue.learn(planes, box), 1) is None

"""A coloured, textured scene with a moving target, and how a cue is learnt and asked on it."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from pydantic import Field, create_model

from bayesnet_track import CueDeclaration
from bayesnet_track.observation.cue import (
    Cue,
    Hypotheses,
    LocallyAdaptable,
    MeasuringCue,
    Reference,
    installed_cues,
)
from bayesnet_track.observation.cue_files import use_cue_file
from bayesnet_track.observation.planes import (
    Frame,
    FramePair,
    PlaneCache,
    Planes,
    Region,
    RightEye,
    StereoGeometry,
    region_of_boxes,
)
from bayesnet_track.observation.plugins import allow

WIDTH, HEIGHT = 320, 240
SIZE = np.array([49.0, 37.0])
START = np.array([150.0, 120.0])
VELOCITY = np.array([5, 3])
NEAR, FAR = 20, 4
"""Disparity of the target and of the background, px: 3 m and 15 m."""
GEOMETRY = StereoGeometry(300.0, 0.2, 160.0, 120.0)


def _texture(rng, rows, columns, cell, low, high):
    coarse = rng.integers(low, high, (rows // cell + 2, columns // cell + 2, 3), dtype=np.uint8)
    fine = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.clip(fine.astype(int) + rng.integers(-6, 7, fine.shape), 0, 255).astype(np.uint8)


def _background(rng):
    image = _texture(rng, HEIGHT, WIDTH, 12, 70, 190)
    image[..., 0] //= 2  # yellowish, so that the target's hues are its own
    return image


def _target(rng):
    rows, columns = int(SIZE[1]), int(SIZE[0])
    image = np.empty((rows, columns, 3), np.uint8)
    image[:] = (200, 60, 40)
    image[: rows // 2, columns // 2 :] = (60, 40, 210)
    image[rows // 2 :, columns // 3 : 2 * columns // 3] = (190, 40, 170)
    light = _texture(rng, rows, columns, 4, 60, 255)[..., :1] / 255.0
    return (image * light).astype(np.uint8)


class Scene:
    """The pictures: the target moves by VELOCITY from frame to frame over a background that rests."""

    width, height, size, start, velocity = WIDTH, HEIGHT, SIZE, START, VELOCITY

    def __init__(self) -> None:
        rng = np.random.default_rng(11)
        self.background, self.target = _background(rng), _target(rng)

    def box(self, shift=(0, 0)):
        return np.concatenate([START + shift, SIZE])

    def image(self, centre, wall=0):
        """The picture with the target at `centre` and the background `wall` px further left."""
        image = np.roll(self.background, -wall, axis=1)
        left, top = (np.asarray(centre) - (SIZE - 1) / 2).astype(int)
        image[top : top + self.target.shape[0], left : left + self.target.shape[1]] = self.target
        return image

    def pair(self, shift=(0, 0)):
        """Current and previous frame with the target now at START + shift."""
        now = START + np.asarray(shift)
        before = now - VELOCITY
        eyes = (self.image(centre - [NEAR, 0], FAR) for centre in (now, before))
        return self.pair_of(self.image(now), self.image(before), True, tuple(eyes))

    def pair_of(self, image, previous, has_color=True, right=None):
        """Two frames; without right eyes, all that they see is as far away as the target."""
        right = right or tuple(np.roll(one, -NEAR, axis=1) for one in (image, previous))
        eyes = [RightEye(one, GEOMETRY) for one in right]
        now = Frame(1, 1.0, image, has_color, 0.04, eyes[0])
        return FramePair(now, Frame(0, 0.0, previous, has_color, 0.0, eyes[1]))

    def around(self, centre, reach=40, step=4):
        """Boxes of the target's size on a grid around `centre`."""
        offset = np.arange(-reach, reach + 1, step, dtype=float)
        dx, dy = (a.ravel() for a in np.meshgrid(offset, offset))
        return np.column_stack([centre[0] + dx, centre[1] + dy, *(np.full(dx.size, side) for side in SIZE)])


@dataclass(frozen=True)
class Asked:
    """A cue and how the engine asks it."""

    declaration: CueDeclaration
    cue: Cue | MeasuringCue

    def planes(self, pair: FramePair, region: Region) -> Planes:
        return PlaneCache(pair).planes(self.cue.needs, region)

    def learn(self, pair: FramePair, box) -> Reference:
        return self.cue.learn(self.planes(pair, region_of_boxes(box[None], 1.0)), box)

    def measure(self, pair: FramePair, boxes, reference, region: Region | None = None, weights=None):
        planes = self.planes(pair, region or region_of_boxes(boxes))
        equal = np.full(len(boxes), 1.0 / len(boxes))
        return self.cue.measure(planes, Hypotheses(boxes), equal if weights is None else weights, reference)

    def score(self, pair: FramePair, boxes, reference, region: Region | None = None):
        planes = self.planes(pair, region or region_of_boxes(boxes))
        return self.cue.log_likelihood(planes, Hypotheses(boxes), reference)


@pytest.fixture(scope="session")
def scene():
    return Scene()


# Cues of other packages, and of files, which are tried as the built-in ones are.
OTHERS = [name for name in os.environ.get("BAYESNET_TRACK_TRY_CUES", "").split(",") if name]
if OTHERS:
    allow(OTHERS)
    installed_cues(OTHERS)
    for one in OTHERS:
        if one.endswith(".py"):
            use_cue_file(one)


def _names(kind):
    """Installed cues of a kind: they score, measure by the picture, or act on their own uncertainty."""
    found = (n for n, one in installed_cues().items() if isinstance(one.make(one.parameters()), kind))
    return sorted(n for n in found if n != "readings" and not installed_cues()[n].reads_detection)


@pytest.fixture(params=_names(MeasuringCue))
def measuring(request):
    declaration = installed_cues()[request.param]
    return Asked(declaration, declaration.make(declaration.parameters()))


VARIANTS = {
    f"motion {flow} {camera}": ("motion", {"flow": flow, "camera": camera})
    for flow, camera in (("sparse", "compensate"), ("dense", "ignore"), ("dense", "auto"), ("odp", "ignore"))
}
"""Further settings of a cue that keep to what its defaults keep to: the cue's name and the settings."""


def _declaration(name):
    """An installed cue's declaration, or that of a variant: the same with other defaults."""
    if name not in VARIANTS:
        return installed_cues()[name]
    base, settings = VARIANTS[name]
    declaration = installed_cues()[base]
    fields = declaration.parameters.model_fields
    others = {
        key: (fields[key].annotation, Field(value, description="other")) for key, value in settings.items()
    }
    model = create_model("Variant", __base__=declaration.parameters, **others)
    return replace(declaration, parameters=model)


@pytest.fixture(params=[*_names(Cue), *(pytest.param(name, marks=pytest.mark.slow) for name in VARIANTS)])
def asked(request):
    declaration = _declaration(request.param)
    return Asked(declaration, declaration.make(declaration.parameters()))


@pytest.fixture(params=_names(LocallyAdaptable))
def adapting(request):
    """A cue that acts on its own uncertainty."""
    declaration = installed_cues()[request.param]
    return Asked(declaration, declaration.make(declaration.parameters()))


@pytest.fixture
def ask():
    """(cue name, parameters) -> the cue, asked as the engine does."""

    def make(name, **parameters):
        declaration = installed_cues()[name]
        return Asked(declaration, declaration.make(declaration.parameters(**parameters)))

    return make

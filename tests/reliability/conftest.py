"""Small videos, and a way to call the command line from a clean process."""

from __future__ import annotations

import importlib.util
import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from bayesnet_track.runtime.recording.videowriter import Background

LONGEST = ("test_soak.py", "test_kill.py", "test_signals.py", "test_crash.py", "test_damaged.py")
FRAMES = 40
SIZE = (64, 48)
CONTAINERS = {
    "start.mp4": ("libx264", {"movflags": "faststart"}),
    "fragments.mp4": ("libx264", {"movflags": "frag_keyframe+empty_moov+default_base_moof"}),
    "plain.mp4": ("libx264", {}),
    "xvid.avi": ("mpeg4", {}),
    "h264.mkv": ("libx264", {}),
}


def pytest_collection_modifyitems(items):
    """The longest first, so that two workers end at about the same time."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


def picture(index):
    image = np.random.default_rng(index % 4).integers(0, 60, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    x = 5 + index
    image[18:30, x : x + 12] = 210
    return image


def write(path, codec, options, frames=FRAMES):
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        stream.codec_context.gop_size = 10
        stream.codec_context.time_base = Fraction(1, 25)
        for index in range(frames):
            frame = av.VideoFrame.from_ndarray(picture(index), format="bgr24")
            frame.pts, frame.time_base = index, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.fixture
def at_once(monkeypatch):
    """What is made in the background is made by the caller: a step has the same number in every run."""
    monkeypatch.setattr(Background, "_is_at_work", lambda _: False)


def load(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def nursery():
    """The module of the small runs that are killed."""
    return load("nursery")


@pytest.fixture(scope="session")
def steps():
    """The module that counts what a run does to its disk."""
    return load("steps")


@pytest.fixture(scope="session")
def videos(tmp_path_factory):
    """A whole video of 40 frames per container: name -> path. The square starts at 5, 18 and is 12 px."""
    folder = tmp_path_factory.mktemp("videos")
    return {name: write(folder / name, *settings) for name, settings in CONTAINERS.items()}


GRAPH = """\
bayesnet: 1
name: small
targets:
  square:
    nodes:
      square: {belief: {particles: {size: 50}}, motion: {random_walk: {sd_px: {x: 3, y: 3}}}}
      gray: {parent: square, agent: intensity}
"""


@pytest.fixture(scope="session")
def graph(tmp_path_factory):
    """The path of a small graph that costs little."""
    path = tmp_path_factory.mktemp("graphs") / "small.yaml"
    path.write_text(GRAPH)
    return path

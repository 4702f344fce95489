"""Networks are tried in a process of their own: what ends it is said, and what went well is tried once."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from bayesnet_track import Tracker
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.vision import siamese_networks
from bayesnet_track.vision.siamese_networks import check_apart

LOADERS = """
import os, signal, time
from pathlib import Path
from bayesnet_track.vision.siamese_networks import working_on

def load(path, how, log):
    with Path(log).open("a") as file:
        file.write(how)
    working_on("a.onnx")
    working_on(path)
    if how == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if how == "hang":
        time.sleep(60)
    if how == "raise":
        bytes([255]).decode()
    if how == "refuse":
        from bayesnet_track.cues.embedding import EmbeddingError
        raise EmbeddingError("no network")
"""


class TrialError(Exception):
    """What the trial is to raise."""


@pytest.fixture
def loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function `how`, contents -> how often it was tried."""
    (tmp_path / "loaders_apart.py").write_text(LOADERS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(siamese_networks, "_tried", set())
    import loaders_apart

    log = tmp_path / "log"

    def tried(how: str, contents: bytes = b"1", name: str = "b.onnx") -> int:
        (tmp_path / name).write_bytes(contents)
        before = log.stat().st_size if log.exists() else 0
        path = str(tmp_path / name)
        check_apart(loaders_apart.load, [path], TrialError, path=path, how=how, log=str(log))
        return ((log.stat().st_size if log.exists() else 0) - before) // len(how)

    yield tried
    del sys.modules["loaders_apart"]


@pytest.mark.skipif(os.name != "posix", reason="there are no signals")
def test_a_crash_names_the_file_and_the_signal_and_is_tried_again(loader) -> None:
    for _ in range(2):
        with pytest.raises(
            TrialError, match=r"b\.onnx: a crash \(SIGSEGV\) where the network was tried: the"
        ):
            loader("crash")


def test_what_goes_on_for_ever_is_ended(loader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(siamese_networks, "SECONDS", 2.0)
    with pytest.raises(TrialError, match=r"no end after 2 s where the network was tried"):
        loader("hang")


def test_what_is_no_error_of_a_network_is_one_of_the_file(loader) -> None:
    with pytest.raises(TrialError, match=r"b\.onnx: UnicodeDecodeError: .*, raised where"):
        loader("raise")


@pytest.mark.parametrize("how", ["well", "refuse"])
def test_the_same_bytes_are_tried_once_also_by_another_process(
    loader, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    assert loader(how) == 1
    assert loader(how) == 0
    monkeypatch.setattr(siamese_networks, "_tried", set())  # as a new process has it
    assert loader(how) == 0
    assert loader(how, contents=b"2") == 1
    assert loader(how, contents=b"1") == 0


def test_what_cannot_be_kept_is_tried_by_each_process(
    loader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").write_text("no folder")
    assert loader("well") == 1
    monkeypatch.setattr(siamese_networks, "_tried", set())
    assert loader("well") == 1


GRAPH = """bayesnet: 1
name: seen
targets:
  one:
    nodes:
      one: {{belief: {{particles: {{size: 50}}}}, motion: {{random_walk: {{sd_px: {{x: 2, y: 2}}}}}}}}
      seen: {{parent: one, agent: {{embedding: {{model: {model}, input_width: 32, input_height: 32}}}}}}
"""


def test_a_graph_whose_network_crashes_is_refused_with_its_file(
    network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever OpenCV makes of the file: what ends the other process is a message of the graph."""
    model = network()
    (tmp_path / "graph.yaml").write_text(GRAPH.format(model=model))
    Tracker(tmp_path / "graph.yaml")
    monkeypatch.setattr(
        siamese_networks,
        "CODE",
        "import os, bayesnet_track.vision.siamese_networks as a; a._say(begins=1); os.abort()",
    )
    monkeypatch.setattr(siamese_networks, "_tried", set())
    Path(model).write_bytes(Path(model).read_bytes() + b"\x00")
    with pytest.raises(GraphError, match=r"network\.onnx: a crash \(SIGABRT\) where the network was tried"):
        Tracker(tmp_path / "graph.yaml")
    assert main(["validate", str(tmp_path / "graph.yaml")]) == 3
    assert "a crash (SIGABRT) where the network was tried" in capsys.readouterr().err

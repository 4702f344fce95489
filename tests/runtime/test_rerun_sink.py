"""The sink for Rerun against a stand-in of its module: what is logged where and when, and what is refused."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.recording.rerun_sink import RerunError, RerunSink, rerun_sinks


class Recording:
    def __init__(self, name):
        self.name, self.logged, self.times, self.calls = name, [], {}, []

    def set_time(self, timeline, **value):
        self.times[timeline] = value

    def log(self, path, entity):
        self.logged.append((tuple(path) if isinstance(path, list) else path, entity, dict(self.times)))

    def __getattr__(self, name):
        return lambda *given: self.calls.append((name, *given))


@pytest.fixture
def made(monkeypatch):
    """The recordings that were made of the stand-in."""
    made = []

    def stream(name):
        made.append(Recording(name))
        return made[-1]

    module = ModuleType("rerun")
    module.RecordingStream = stream
    for kind in ("EncodedImage", "Boxes2D", "Points2D", "Scalars", "TextLog", "Clear"):
        setattr(
            module,
            kind,
            lambda *values, kind=kind, **fields: SimpleNamespace(kind=kind, values=values, **fields),
        )
    monkeypatch.setitem(sys.modules, "rerun", module)
    return made


def line(frame, target):
    return FrameMetrics(
        frame=frame, time_s=frame / 25, target=target, centre_box=(10.0, 8.0, 5.0, 3.0), map=(),
        sd=(1.0,) * 4,
        ud_px2=7.5, ud_nodes={}, quiet_px2=None, status="tracking", score=0.5, log_evidence=0.0, surprise=0.0,
        ess=9.0, particles=10, active=("color",), kl={"color": 0.25}, contribution={}, agent_ud_px2={},
        strength={}, learn_rate=0.0, region50=(), region90=(), cloud=((10, 8, 5, 3),),
    )  # fmt: skip


def result(index, *targets):
    frame = SimpleNamespace(index=index, image=np.zeros((16, 20, 3), np.uint8))
    return SimpleNamespace(frame=frame, targets=tuple(line(index, target) for target in targets))


def test_a_frame_is_logged_at_its_time(made, tmp_path):
    with rerun_sinks(str(tmp_path / "new" / "run.rrd"), "graph") as (sink,):
        sink.event(TargetStarted(0, "1", "plate", (10.0, 8.0, 5.0, 3.0), ("color",)))
        sink.frame(result(0, "1"))
        sink.frame(result(3, "1"))
    (recording,) = made
    assert recording.name == "graph"
    assert recording.calls == [("save", tmp_path / "new" / "run.rrd"), ("flush",), ("disconnect",)]
    last = {path: entity for path, entity, times in recording.logged if times["frame"] == {"sequence": 3}}
    assert recording.logged[-1][2]["time"] == {"duration": 3 / 25}
    box = last["video", "1", "box"]
    assert (box.mins, box.sizes) == ([(8.0, 7.0)], [(5.0, 3.0)])
    assert last["video", "1", "cloud"].values[0].tolist() == [[10.5, 8.5]]
    assert last["ud", "1"].values == (7.5,) and last["kl", "1", "color"].values == (0.25,)
    assert last["video"].media_type == "image/jpeg" and last["video"].contents[:2] == b"\xff\xd8"
    (start,) = [entity for path, entity, _ in recording.logged if path == "events"]
    assert "target 1 starts as plate" in start.values[0] and start.level == "INFO"


def test_events_belong_to_their_frame_and_the_end_is_told_at_once(made):
    sink = RerunSink(None)
    sink.frame(result(0, "1"))
    sink.event(Quarantined(1, "1", "color", "it raised"))
    assert [entity.kind for path, entity, _ in made[0].logged if path == "events"] == []
    sink.frame(result(1, "1"))
    sink.event(RunEnded(2, 2, True, "end_of_source"))
    logged = [(entity.level, times["frame"]) for path, entity, times in made[0].logged if path == "events"]
    assert logged == [("WARN", {"sequence": 1}), ("INFO", {"sequence": 1})]
    assert made[0].calls == [("spawn",)]


def test_the_end_is_told_where_no_target_is_left(made):
    sink = RerunSink(None)
    sink.frame(result(0))
    sink.event(RunEnded(1, 0, True, "end_of_source"))
    assert [entity.kind for path, entity, _ in made[0].logged if path == "events"] == ["TextLog"]


def test_a_target_that_ended_is_cleared(made):
    sink = RerunSink(None)
    sink.frame(result(0, "1", "2"))
    sink.frame(result(1, "2"))
    cleared = [path for path, entity, _ in made[0].logged if entity.kind == "Clear"]
    assert cleared == [("video", "1")]


def test_without_rerun_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(RerunError, match=r"pip install 'bayesnet-track\[rerun\]'"):
        RerunSink(None)


def test_another_package_of_that_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", ModuleType("rerun"))
    with pytest.raises(RerunError, match="another package"):
        RerunSink(None)


def test_a_file_that_is_there_stays(made, tmp_path):
    path = tmp_path / "old.rrd"
    path.write_bytes(b"old")
    with pytest.raises(RerunError, match="overwrite=True"), rerun_sinks(str(path), "g"):
        pass
    assert path.read_bytes() == b"old" and made == []
    with pytest.raises(RerunError, match="cannot open"):
        RerunSink(path / "inside.rrd")

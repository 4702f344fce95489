"""Which frames are read, for notices of what is not used of agents' files."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from bayesnet_track import load_graph, track
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.sources import open_source


def test_a_window_of_a_source_is_what_is_read(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for frame in SceneSource.named("occluder_long", 0, 10):
        assert isinstance(frame, Frame)
        cv2.imwrite(str(tmp_path / "frames" / f"{frame.index:03}.png"), frame.image)
    rows = "".join(f"{k},300,-1\n" for k in range(10))
    (tmp_path / "radar.csv").write_text(f"frame,range,bearing\n{rows}")
    change = f"radar.agent.readings.file={tmp_path / 'radar.csv'}"
    graph = change_graph(load_graph("radar_ball").text, [change])
    box = SceneSource.named("occluder_long", 0, 1).scene.start_box
    with (
        open_source(str(tmp_path / "frames"), start=2, end=9, stride=2) as source,
        pytest.warns(InputNotice, match=r"6 of 10 readings are of frames that are not read \(0 to 9\)"),
    ):
        track(graph, source, box).close()

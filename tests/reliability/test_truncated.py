"""Row 4: a video cut at 50 points is always reported where its container says how long it is."""

import re

import av
import pytest

from bayesnet_track import open_run
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.runs import RunEnded, SourceDamaged

pytestmark = pytest.mark.reliability
FRAMES, POINTS = 40, 50


def pictures_of(path):
    """Where the first picture's bytes begin, where the second one's end, and where the last one's end."""
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    return packets[0].pos, packets[1].pos + packets[1].size, packets[-1].pos + packets[-1].size


@pytest.mark.parametrize("name", ["start.mp4", "plain.mp4", "xvid.avi", "h264.mkv"])
def test_a_cut_video_ends_with_its_exit_code_and_how_far_it_came(videos, graph, tmp_path, name, capsys):
    data = videos[name].read_bytes()
    path, read, refused = tmp_path / name, [], []
    first, second, last = pictures_of(videos[name])
    for part in range(POINTS):
        cut = first + (last - first) * part // POINTS
        path.write_bytes(data[:cut])
        out = tmp_path / f"run{part}"
        line = ["run", str(graph), "--source", str(path), "--init", "5,18,12,12", "--out", str(out)]
        code = main([*line, "--quiet"])
        said = capsys.readouterr().err
        if code == 4:
            assert "not a readable video" in said or "no frame can be read" in said
            refused.append(cut)
            continue
        events = open_run(out).events
        ended = events[-1]
        assert isinstance(ended, RunEnded)
        assert (code, ended.complete, ended.reason) == (5, False, "source_truncated")
        reason = [event.reason for event in events if isinstance(event, SourceDamaged)][-1]
        assert re.search(rf"truncated: read \d+ of {FRAMES} frames", reason) and reason in said
        read.append(ended.frames)
    assert read == sorted(read)
    # Without its index, which it has at the end, an MP4 cannot be opened at all.
    assert len(read) + len(refused) == POINTS
    assert not read if name == "plain.mp4" else max(refused) < second

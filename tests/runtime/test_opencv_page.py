"""The program on the page "From OpenCV to this", run as it stands there on a video of a scene."""

import re
from pathlib import Path

from bayesnet_track.runtime.recording.videowriter import VideoWriter
from bayesnet_track.sources.scenes import make_scene

PAGE = Path(__file__).parents[2] / "docs" / "opencv.md"


def test_the_program_runs_and_follows(tmp_path, monkeypatch, capsys):
    program = re.search(
        r"```python\n(import cv2\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    ).group(1)
    scene = make_scene("two_squares")
    height, width = scene.frames[0].shape[:2]
    with VideoWriter(tmp_path / "video.mp4", width, height, 0.04) as video:
        for index in range(8):
            video.write(scene.frames[index])
    monkeypatch.chdir(tmp_path)
    start = ", ".join(str(round(value)) for value in scene.start_box)
    exec(compile(program.replace("57, 21, 31, 45", start), str(PAGE), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7
    found = re.search(r"True \((\d+), (\d+), \d+, \d+\) [01]\.\d+ tracking", lines[-1])
    x, y = map(int, found.groups())
    true = scene.truth[7]
    # Off by less than a quarter of its size: it is on the square, through a lossy codec.
    assert abs(x - true[0]) < true[2] / 4 and abs(y - true[1]) < true[3] / 4

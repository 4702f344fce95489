"""`log --short`, the colour of statuses, and the folder that a run is written to without --out."""

from __future__ import annotations

import io
import re

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.arguments import by_status
from bayesnet_track.cli.main import main

LINE = "frame 9: UD 8 px² > 3 for 3 frames → ball 1 lost; would not have been lost at lost.above ≥ 9"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.slow
def test_the_short_log_has_each_change_without_reasons(tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["demo", "two_squares", "--end", "60", "-o", str(out), "-q"]) == 0
    capsys.readouterr()
    assert main(["log", str(out)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert main(["log", str(out), "--short"]) == 0
    short = capsys.readouterr().out.splitlines()
    assert len(short) == len(told) > 3
    assert any(re.fullmatch(r"frame \d+: motion on", line) for line in short)
    assert not any("would" in line or "px²" in line for line in short[1:-1])
    assert main(["log", str(out), "--short", "--kind", "activated"]) == 0
    assert set(capsys.readouterr().out.splitlines()) < set(short)


def test_a_status_is_coloured_in_a_terminal_only(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert by_status(LINE, io.StringIO()) == LINE
    assert by_status(LINE, Terminal()) == LINE.replace("1 lost;", "1 \x1b[31mlost\x1b[0m;")
    assert by_status("frame 3: motion on", Terminal()) == "frame 3: motion on"
    monkeypatch.setenv("TERM", "dumb")
    assert by_status(LINE, Terminal()) == LINE
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    assert by_status(LINE, Terminal()) == LINE


def test_runs_without_a_folder_are_numbered(tmp_path, monkeypatch, two_frames):
    monkeypatch.chdir(tmp_path)
    command = ["run", "gray_square", "--source", str(two_frames), "--init", "4,4,8,8", "-q"]
    for folder in ("runs/gray_square", "runs/gray_square-2", "runs/gray_square-3"):
        assert main(command) == 0
        assert (tmp_path / folder / "journal.jsonl").is_file()


@pytest.fixture
def two_frames(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(2):
        picture = np.full((48, 64, 3), (90, 60, 30), dtype=np.uint8)
        picture[4:12, 4:12] = 200
        cv2.imwrite(str(folder / f"{number}.png"), picture)
    return folder

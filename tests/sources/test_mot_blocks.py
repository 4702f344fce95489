"""Large files of MOT lines are read in blocks, with the same result as line by line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.evaluate import paired_boxes
from bayesnet_track.sources import mot_blocks
from bayesnet_track.sources.mot_blocks import read_plain_boxes

FRAMES, PEOPLE = 40, 9


def lines_of(seed: int, score: str = "") -> list[str]:
    rng = np.random.default_rng(seed)
    places = rng.uniform(50, 900, (PEOPLE, 2))
    lines = []
    for frame in range(1, FRAMES + 1):
        places += rng.normal(0, 2, places.shape)
        for person in rng.permutation(PEOPLE)[: PEOPLE - 1]:
            x, y = places[person]
            lines.append(
                f"{frame},{person + 1},{x:.3f},{y:.3f},20,44,{score or format(rng.uniform(), '.6f')},-1,-1,-1"
            )
    return lines


@pytest.fixture
def in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file counts as large, and a block holds a few lines."""
    monkeypatch.setattr(mot_blocks, "LARGE", 0)
    monkeypatch.setattr(mot_blocks, "_BLOCK", 500)
    monkeypatch.setattr(paired_boxes, "MOST_HELD", 0)
    monkeypatch.setattr(paired_boxes, "_BLOCK_PAIRS", 300)


def test_scores_are_those_of_a_small_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    truth, tracks = tmp_path / "truth.txt", tmp_path / "tracks.txt"
    truth.write_text("\n".join(lines_of(0, "1")) + "\n")
    tracks.write_text("\n".join(lines_of(0)[5:-3]) + "\n")
    said = []
    for _ in range(2):
        assert main(["score", str(tracks), "--truth", str(truth), "--json"]) == 0
        said.append(capsys.readouterr().out)
        request.getfixturevalue("in_blocks")
        plain = read_plain_boxes(tracks)
        assert plain is not None and len(plain.frames) == len(lines_of(0)) - 8
    values = [json.loads(text) for text in said]
    assert values[0].keys() == values[1].keys() and values[0]["hota"] > 0.2
    for name, value in values[0].items():
        expected = None if value is None else pytest.approx(value, rel=1e-6, abs=1e-6)
        assert values[1][name] == expected, name


def changed(place: int, line: str) -> list[str]:
    lines = lines_of(1)
    return [*lines[:place], line, *lines[place + 1 :]]


@pytest.mark.usefixtures("in_blocks")
@pytest.mark.parametrize(
    "lines",
    [
        changed(100, ""),
        changed(100, "13,3,50.0,60.0,nan,20,0.5,-1,-1,-1"),
        changed(100, "13,3,50.0,60.0,20,0,0.5,-1,-1,-1"),
        changed(100, "13,3,50.0,60.0,,20,0.5,-1,-1,-1"),
        changed(100, "13,3,50.0,60.0,10,20,0.5,-1,-1,-1,-1"),
        changed(100, "13,3,50.0,60.0,10,20,0.5"),
        changed(100, "13.5,3,50.0,60.0,10,20,0.5,-1,-1,-1"),
        changed(100, "13,3,50.0,6-0.0,10,20,0.5,-1,-1,-1"),
        changed(100, "2,3,50.0,60.0,10,20,0.5,-1,-1,-1"),
        changed(0, "0,3,50.0,60.0,10,20,0.5,-1,-1,-1"),
        changed(0, "frame,id,left,top,width,height,confidence,x,y,z"),
        changed(101, lines_of(1)[100]),
        [line.replace(",-1,-1,-1", ",1,0.5") for line in lines_of(1)],
        [line.replace(",", " ") for line in lines_of(1)],
        [f"{n + 1},{n},0.2,0.3,0.4,0.5,1" for n in range(50)],
        [f"{n + 1},1,{n},{n},{n + 40},{n + 60},1" for n in range(50)],
    ],
)
def test_what_is_not_plain_is_left_to_the_reader_of_lines(tmp_path: Path, lines: list[str]) -> None:
    path = tmp_path / "tracks.txt"
    path.write_text("\n".join(lines) + "\n")
    assert read_plain_boxes(path) is None


@pytest.mark.usefixtures("in_blocks")
def test_a_last_line_without_an_end_is_left_to_the_reader_of_lines(tmp_path: Path) -> None:
    path = tmp_path / "tracks.txt"
    path.write_text("\n".join(lines_of(1)))
    assert read_plain_boxes(path) is None
    path.write_text("\n".join(lines_of(1)) + "\n")
    assert read_plain_boxes(path) is not None


@pytest.mark.usefixtures("in_blocks")
def test_numbers_are_read_as_python_reads_them(tmp_path: Path) -> None:
    """Of up to 15 digits, and of more."""
    rng = np.random.default_rng(3)
    words = [
        f"{rng.integers(1, 10**4):d}.{rng.integers(0, 10**digits):0{digits}d}"
        for digits in (1, 3, 6, 12)
        for _ in range(100)
    ]
    words += ["007", "12.", "5", ".25"]
    path = tmp_path / "tracks.txt"
    words = [sign + word for word in words for sign in ("", "-")]
    path.write_text("".join(f"{n + 1},4,{word},{word},30,20,1,-1,-1,-1\n" for n, word in enumerate(words)))
    plain = read_plain_boxes(path)
    numbers = np.array([float(word) for word in words]).astype(np.float32)
    assert plain is not None and (plain.boxes[:, :2] == numbers[:, None]).all()

"""A run directory is data that may come from anywhere: edited files are reported, others stay untouched."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import random
import shutil
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.frame_file import FrameFile, record
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.sources.scenes.library import SceneSource

HUGE = b'{"frame": 1, "seconds": 1e999}'
READERS = (["log"], ["log", "--why", "12"], ["report", "--frames", "none"], ["export", "--format", "coco"])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    run = tmp_path_factory.mktemp("whole") / "run"
    assert main(["demo", "two_squares", "--end", "20", "--quiet", "--out", str(run)]) == 0
    return run


@pytest.fixture
def finished(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "finished")


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run over a folder of pictures, broken off after three of six frames."""
    home = tmp_path_factory.mktemp("begun")
    (home / "frames").mkdir()
    source = SceneSource.named("two_squares", 0, 6)
    for frame in source:
        cv2.imwrite(str(home / "frames" / f"{frame.index}.png"), frame.image)
    results = track("two_squares", home / "frames", source.scene.start_box, out=home / "run")
    for _ in itertools.islice(results, 3):
        pass
    results.close()
    return home


@pytest.fixture
def unfinished(begun: Path, tmp_path: Path) -> Path:
    return shutil.copytree(begun / "run", tmp_path / "run")


def line_of(run: Path, name: str, number: int, change: Callable[[dict[str, object]], object]) -> None:
    """Change one line."""
    lines = (run / name).read_text().splitlines()
    value = json.loads(lines[number])
    value = change(value) or value
    lines[number] = json.dumps(value)
    (run / name).write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("name", "number", "change"),
    [
        ("journal.jsonl", 0, lambda line: line.update(frame_interval_s=10**400)),
        ("journal.jsonl", 0, lambda line: line.update(width=0)),
        ("journal.jsonl", 1, lambda line: line.update(frame=2**31)),
        ("journal.jsonl", 1, lambda line: line.update(target="2")),
        ("journal.jsonl", 1, lambda line: line.update(template="nobody")),
        ("journal.jsonl", 2, lambda line: line.update(frame=-1)),
    ],
)
def test_an_edited_line_is_reported_with_its_place_and_no_traceback(
    finished: Path,
    whole: Path,
    name: str,
    number: int,
    change: Callable[[dict[str, object]], object],
    capsys: pytest.CaptureFixture[str],
) -> None:
    line_of(finished, name, number, change)
    codes = set()
    for command, *options in (*READERS, ["compare", str(whole)]):
        codes.add(main([command, str(finished), *options]))
        said = capsys.readouterr().err
        assert "Traceback" not in said
    assert codes <= {0, 4} and 4 in codes


@pytest.mark.parametrize(
    "column",
    [
        {"cloud_count": np.array([7], "<i4")},
        {"box": np.ones((1, 1), "<f4")},
        {"particles": np.array([-1], "<i4")},
        {"region50": np.ones((4, 0), "<f4")},
        {"target": np.array([b"nobody"])},
    ],
    ids=["hypotheses", "box", "particles", "region", "target"],
)
def test_a_frame_of_something_else_is_reported_with_its_place_and_no_traceback(
    finished: Path, whole: Path, column: dict[str, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    columns = list(FrameFile(finished / "frames.npy.gz").columns())
    columns[3] = {**columns[3], **column}
    (finished / "frames.npy.gz").write_bytes(b"".join(map(record, columns)))
    codes = set()
    for command, *options in (*READERS, ["compare", str(whole)]):
        codes.add(main([command, str(finished), *options]))
        assert "Traceback" not in capsys.readouterr().err
    assert codes <= {0, 4} and 4 in codes


@pytest.mark.parametrize("at", [0, 5, 40, 300, -30, -3])
def test_a_changed_byte_of_a_frame_is_reported(
    finished: Path, at: int, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray((finished / "frames.npy.gz").read_bytes())
    data[at] ^= 0xFF
    (finished / "frames.npy.gz").write_bytes(data)
    for command, *options in READERS:
        assert main([command, str(finished), *options]) in (0, 4)
        assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        b"\xff\xfe",
        b"[" * 100_000,
        b"null",
        b'{"frame": 1e999, "seconds": 1}',
        b'{"frame": 1, "seconds": 1e999}',
    ],
    ids=["not UTF-8", "deep", "no object", "huge", "endless"],
)
def test_edited_timings_crash_nothing(
    finished: Path, whole: Path, line: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (finished / "timings.jsonl").read_bytes().split(b"\n")
    (finished / "timings.jsonl").write_bytes(b"\n".join([*lines[:3], line, *lines[3:]]))
    truth = str(whole / "truth.txt")
    for command, *options in (*READERS, ["compare", str(whole)], ["score", "--truth", truth]):
        assert main([command, str(finished), *options]) in (0, 2, 4)
        assert "Traceback" not in capsys.readouterr().err


class Asked(BaseHTTPRequestHandler):
    """Counts the requests that it gets."""

    count = 0

    def do_GET(self) -> None:
        type(self).count += 1
        self.send_error(404)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[HTTPServer]:
    Asked.count = 0
    with HTTPServer(("127.0.0.1", 0), Asked) as one:
        thread = threading.Thread(target=one.serve_forever, daemon=True)
        thread.start()
        yield one
        one.shutdown()


@pytest.mark.parametrize("protocol", ["http://", "rtsp://", "concat:", "subfile,,start,0,end,0,,:"])
def test_a_source_that_became_another_protocol_is_refused(
    unfinished: Path,
    begun: Path,
    server: HTTPServer,
    protocol: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The folder beside it has the recorded content and the name of a URL."""
    address = f"127.0.0.1:{server.server_port}"
    where = f"{protocol}{address}/v"
    monkeypatch.chdir(tmp_path)
    shutil.copytree(begun / "frames", tmp_path / where)
    recipe = json.loads((unfinished / "run.json").read_text())
    origin = recipe["origin"]
    origin["allow_network"] = True
    origin["absolute"] = {origin["text"]: where}
    (unfinished / "run.json").write_text(json.dumps(recipe))
    for name in ("checkpoint", "checkpoint.previous"):
        (unfinished / name).unlink(missing_ok=True)
    assert main(["resume", str(unfinished), "--quiet"]) == 4
    assert main(["what-if", str(unfinished), "--seed", "1", "--out", str(tmp_path / "new")]) == 4
    assert "network" in (said := capsys.readouterr().err) or "protocol" in said
    assert Asked.count == 0


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege there")
@pytest.mark.parametrize("name", ["journal.jsonl", "frames.npy.gz", "checkpoint"])
def test_resume_writes_through_no_link(unfinished: Path, name: str, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_bytes((unfinished / name).read_bytes())
    held = mine.read_bytes()
    (unfinished / name).unlink()
    (unfinished / name).symlink_to(mine)
    with pytest.raises(ResumeError, match="link"):
        list(resume(unfinished))
    assert mine.read_bytes() == held


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there is no such device")
def test_a_recorded_file_that_is_a_device_is_not_read(
    unfinished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = json.loads((unfinished / "run.json").read_text())
    recipe["detections"] = {"path": "/dev/zero", "absolute": "/dev/zero", "sha256": "0" * 64}
    (unfinished / "run.json").write_text(json.dumps(recipe))
    assert main(["resume", str(unfinished), "--quiet"]) == 4
    assert "/dev/zero" in capsys.readouterr().err


def sealed(body: bytes) -> bytes:
    seal = hashlib.sha256(body).hexdigest().encode()
    return b"\n".join((b"bayesnet_track checkpoint 2", seal, body))


def forgeries(checkpoint: bytes, number: int) -> bytes:
    """The checkpoint with something changed, sealed again where that is what a forger would do."""
    rng = random.Random(number)
    _, _, body = checkpoint.split(b"\n", 2)
    header, state = body.split(b"\n", 1)
    places, rest = state.split(b"\n", 1)
    size, arrays = json.loads(places)
    kind = number % 8
    if kind == 0:
        data = bytearray(checkpoint)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data)
    if kind == 1:
        return checkpoint[: rng.randrange(len(checkpoint))]
    if kind == 2:
        data = bytearray(body)
        data[rng.randrange(len(header))] ^= 1 << rng.randrange(8)
        return sealed(bytes(data))
    if kind == 3:
        fields = json.loads(header)
        fields[rng.choice(list(fields))] = rng.choice([None, -1, "x", [], {}, 1e300, 2**70, {"a": 1}, [[1]]])
        return sealed(json.dumps(fields).encode() + b"\n" + state)
    if kind == 4:
        data = bytearray(state)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return sealed(header + b"\n" + bytes(data))
    if kind == 5:
        one = rng.choice(arrays)
        one[rng.randrange(4)] = rng.choice(
            [[2**40], [-1, -4], "O", "V8", "<f8", [2**62] * 3, "C", None, True, [0]]
        )
        return sealed(header + b"\n" + json.dumps([size, arrays]).encode() + b"\n" + rest)
    structure = json.loads(rest[:size])
    place, parents = structure, []
    while isinstance(place, list) and len(place) > 1 and (not parents or rng.random() < 0.9):
        parents.append((place, rng.randrange(1, len(place))))
        place = place[parents[-1][1]]
    holder, at = parents[-1]
    holder[at] = rng.choice(
        [None, -1, "x", 1e300, ["t"], ["m"], ["=", 0], ["a", 0], ["p"], ["o", "State"], ["z"]]
    )
    text = json.dumps(structure).encode()
    if kind == 7:
        text = b"[" * 50_000
    line = json.dumps([len(text), arrays]).encode()
    return sealed(header + b"\n" + line + b"\n" + text + rest[size:])


def forged(unfinished: Path, number: int, capsys: pytest.CaptureFixture[str]) -> int:
    data = forgeries((unfinished / "checkpoint").read_bytes(), number)
    (unfinished / "checkpoint.previous").unlink(missing_ok=True)
    (unfinished / "checkpoint").write_bytes(data)
    code = main(["resume", str(unfinished), "--quiet"])
    said = capsys.readouterr().err
    assert "Traceback" not in said, (number, said)
    assert code in (0, 4), (number, code, said)
    return code


@pytest.mark.parametrize("number", range(2, 8))
def test_a_forged_checkpoint_is_an_error_not_a_crash(
    unfinished: Path, number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    forged(unfinished, number, capsys)


@pytest.mark.reliability
def test_100_forged_checkpoints_are_errors_not_crashes(
    begun: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = 0
    for number in range(100):
        run = shutil.copytree(begun / "run", tmp_path / str(number))
        refused += forged(run, number, capsys) == 4
        shutil.rmtree(run)
    assert refused > 50


STRANGE = [1e308, 2**63, 10**400, 0, -1, True, None, "", "NaN", "\ud800", [], {}, [[]], {"a": 1}, [1] * 50]
BYTES = [b"\xff\xfe", b"null", b"{}", b"[" * 100_000, b'{"event":' * 20_000, b"1" * 5000, b'{"event": []}']


def edited(data: bytes, rng: random.Random) -> bytes:
    """Lines gone, swapped, doubled, cut, of other bytes, or with another value at a random place."""
    lines = data.split(b"\n")
    at, kind = rng.randrange(len(lines) - 1), rng.random()
    if kind < 0.1:
        del lines[at]
    elif kind < 0.2:
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    elif kind < 0.25:
        lines.insert(at, lines[rng.randrange(len(lines))])
    elif kind < 0.35:
        lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
    elif kind < 0.45:
        lines[at] = rng.choice(BYTES)
    else:
        value = place = json.loads(lines[at])
        while True:
            key = rng.choice(list(place)) if isinstance(place, dict) else rng.randrange(len(place))
            if not (isinstance(place[key], dict | list) and place[key] and rng.random() < 0.8):
                break
            place = place[key]
        if kind < 0.55 and isinstance(place, dict):
            del place[key]
        else:
            place[key] = rng.choice(STRANGE)
        lines[at] = json.dumps(value).encode()
    return b"\n".join(lines)


@pytest.mark.reliability
@pytest.mark.parametrize("name", ["journal.jsonl", "timings.jsonl"])
def test_60_edited_files_each_crash_no_command(
    name: str, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, page = shutil.copytree(whole, tmp_path / "run"), str(tmp_path / "page.html")
    commands = [*READERS, ["log", "--json"], ["log", "--target", "1"], ["export", "--format", "jsonl"]]
    commands += [["compare", str(whole), "--html", page, "--overwrite"], ["score"]]
    data, refused = (run / name).read_bytes(), 0
    for number in range(60):
        (run / name).write_bytes(edited(data, random.Random(number)))
        for command, *options in commands:
            code = main([command, str(run), *options])
            said = capsys.readouterr().err
            assert code in (0, 2, 4) and "Traceback" not in said, (number, command, options, said)
            refused += code == 4
    assert refused > 20

"""Runs through the sources and detections of several cameras, merged by time."""

from __future__ import annotations

import base64
import csv
import json
import re

import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.cli.commands.diagnose import advise
from bayesnet_track.cli.findings import Finding
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError
from bayesnet_track.journal.events.cameras import ClockLearnt
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.runtime.recording.run_reader import open_run
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.view.page_tables import unpack
from tests.engine.test_several_cameras import CAMERAS, boxes_of, write_graph

COUNT, PLACE = 20, np.array([-2.0, 9.0])
RATES = {"south": 20, "east": 10}


def place_at(time_s):
    return PLACE + time_s * np.array([1.4, 0.4])


@pytest.fixture
def room(tmp_path):
    """Files of a graph and of two cameras, of which `east` has half the frames."""
    for camera, rate in RATES.items():
        (tmp_path / camera).mkdir()
        width, height = CAMERAS[camera].size
        (tmp_path / camera / "seqinfo.ini").write_text(
            f"[Sequence]\nimWidth={width}\nimHeight={height}\nframeRate={rate}\nseqLength=1\n"
        )
        lines = []
        for frame in range(COUNT * rate // 20):
            x, y, w, h = boxes_of(camera, place_at(frame / rate))[0]
            lines.append(f"{frame + 1},-1,{x - (w - 1) / 2},{y - (h - 1) / 2},{w},{h},0.9,-1,-1,-1")
        (tmp_path / camera / "boxes.txt").write_text("\n".join(lines) + "\n")
    return write_graph(tmp_path)


def detections_in(room):
    return {camera: room.parent / camera / "boxes.txt" for camera in RATES}


def options_of(files, option="--detections"):
    return [part for camera, path in files.items() for part in (option, f"{camera}={path}")]


def test_each_camera_has_its_own_rate_and_one_belief_is_in_metres(room, tmp_path):
    out = tmp_path / "run"
    steps = list(track(room, None, detections=detections_in(room), out=out))
    assert [result.frame.time_s for result in steps] == pytest.approx([k / 20 for k in range(COUNT)])
    assert [tuple(result.frame.cameras) for result in steps[:3]] == [("south", "east"), ("south",)] * 1 + [
        ("south", "east")
    ]
    (target,) = steps[-1].targets
    place = place_at((COUNT - 1) / 20)
    assert np.hypot(target.state["x_m"] - place[0], target.state["y_m"] - place[1]) < 0.05
    assert target.state["vx"] == pytest.approx(1.4, abs=0.1)
    rows = list(csv.DictReader((out / "cameras.csv").open()))
    last = {camera: [row for row in rows if row["camera"] == camera][-1] for camera in RATES}
    assert [last["south"]["camera_frame"], last["east"]["camera_frame"]] == ["19", "9"]
    for camera, row in last.items():
        x, y, w, h = (float(row[name]) for name in "xywh")
        expected = boxes_of(camera, place_at(int(row["camera_frame"]) / RATES[camera]))[0]
        np.testing.assert_allclose([x + (w - 1) / 2, y + (h - 1) / 2, w, h], expected, atol=4.0)


def test_the_command_line_gives_equal_bytes_in_any_order_of_the_cameras(room, tmp_path, capsys):
    files = detections_in(room)
    for name, order in (("a", [*files]), ("b", [*files][::-1])):
        named = options_of({camera: files[camera] for camera in order})
        assert main(["run", str(room), *named, "--out", str(tmp_path / name), "--quiet"]) == 0
    for file in ("tracks.csv", "cameras.csv", "frames.npy.gz", "tracks.txt"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    capsys.readouterr()
    assert main(["log", str(tmp_path / "a")]) == 0
    log = capsys.readouterr().out
    assert "seen.south, seen.east on" in log
    assert "south=" in log
    assert main(["log", str(tmp_path / "a"), "--node", "seen.south"]) == 0
    assert main(["verify", str(tmp_path / "a")]) == 0


def test_a_missing_file_of_detections_is_that_of_its_option_and_camera(room, tmp_path, capsys):
    files = detections_in(room) | {"east": tmp_path / "gone.txt"}
    assert main(["run", str(room), *options_of(files), "--out", str(tmp_path / "run"), "--quiet"]) == 2
    error = capsys.readouterr().err
    assert f"--detections of east: {tmp_path / 'gone.txt'}: No such file or directory; expected" in error


def test_it_is_scored_in_metres(room, tmp_path, capsys):
    out, truth = tmp_path / "run", tmp_path / "truth.csv"
    for _ in track(room, None, detections=detections_in(room), out=out):
        pass
    lines = [f"{k / 20},1,{x},{y}" for k in range(COUNT) for x, y in [place_at(k / 20)]]
    truth.write_text("t,id,x,y\n" + "\n".join(lines) + "\n")
    capsys.readouterr()
    assert main(["score", str(out), "--truth", str(truth)]) == 0
    scores = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines())
    assert float(scores["mota"]) > 0.85
    assert float(scores["idf1"]) > 0.9


@pytest.mark.slow
def test_videos_of_the_cameras(room, tmp_path):
    import cv2

    videos = {}
    for camera, rate in RATES.items():
        videos[camera] = str(tmp_path / f"{camera}.avi")
        writer = cv2.VideoWriter(videos[camera], cv2.VideoWriter.fourcc(*"MJPG"), rate, CAMERAS[camera].size)
        for frame in range(COUNT * rate // 20):
            writer.write(np.full((*CAMERAS[camera].size[::-1], 3), 10 * frame, np.uint8))
        writer.release()
    out = tmp_path / "run"
    named = [*options_of(videos, "--source"), *options_of(detections_in(room))]
    assert main(["run", str(room), *named, "--out", str(out), "--quiet"]) == 0
    boxes_only = tmp_path / "boxes_only"
    assert (
        main(["run", str(room), *options_of(detections_in(room)), "--out", str(boxes_only), "--quiet"]) == 0
    )
    assert (out / "tracks.csv").read_bytes() == (boxes_only / "tracks.csv").read_bytes()
    header, columns, data = page_of(out)
    for camera, rate in RATES.items():
        steps, ends = columns[f"pictures/{camera}/frame"], columns[f"pictures/{camera}/end"]
        starts = [header["pictures"]["starts"][camera], *ends[:-1]]
        levels = [
            float(cv2.imdecode(np.frombuffer(data[start:end], np.uint8), cv2.IMREAD_COLOR).mean())
            for start, end in zip(starts, ends, strict=True)
        ]
        frames = np.arange(1, COUNT * rate // 20)  # the first one is black, as that of detections alone
        np.testing.assert_array_equal(steps, frames * 20 // rate)
        np.testing.assert_allclose(levels, 10 * frames, atol=4)
    folder = tmp_path / "whole"
    assert main(["report", str(out), "--frames", "full", "--out", str(folder)]) == 0
    for camera, rate in RATES.items():
        names = sorted(path.name for path in (folder / "frames" / camera).iterdir())
        assert names == [f"{step:06d}.jpg" for step in range(20 // rate, COUNT, 20 // rate)]


def page_of(run):
    """Header, columns and pictures of the page of a run."""
    assert main(["report", str(run)]) == 0
    text = (run / "report.html").read_text(encoding="utf-8")
    data, pictures = (
        base64.b64decode(re.search(f'id="run-{name}">([^<]*)<', text)[1]) for name in ("data", "pictures")
    )
    return *unpack(data), pictures


def test_the_page_has_the_boxes_of_each_camera_and_the_ground_in_metres(room, tmp_path):
    out = tmp_path / "run"
    assert main(["run", str(room), *options_of(detections_in(room)), "--out", str(out), "--quiet"]) == 0
    header, columns, pictures = page_of(out)
    assert pictures == b"" and header["pictures"]["without"] == "the sources of the run have none"
    with (out / "tracks.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["target"] == "1"]
    fields = ("x_m", "y_m", "x_m_sd", "y_m_sd", "xy_corr")
    expected = [[float(row[field]) for field in fields] for row in rows]
    np.testing.assert_allclose(columns["0/ground"], expected, rtol=1e-4, atol=1e-6)
    frames = columns["0/frame"].tolist()
    with (out / "cameras.csv").open() as file:
        for row in csv.DictReader(file):
            x, y, w, h = (float(row[name]) for name in "xywh")
            box = columns[f"0/cameras/{row['camera']}"][frames.index(int(row["frame"]))]
            np.testing.assert_allclose(box, [x + (w - 1) / 2, y + (h - 1) / 2, w, h], rtol=1e-4, atol=0.01)
    for entry in header["cameras"]:
        camera = CAMERAS[entry["name"]]
        np.testing.assert_allclose(entry["at"], -camera.rotation.T[:2] @ camera.translation, atol=1e-9)
        field = np.array(entry["field"])
        pixels = camera.project(np.column_stack([field, np.zeros(len(field))]))
        assert (pixels > -1.0).all() and (pixels < np.array(camera.size)).all() and len(field) > 20


def test_a_page_without_the_calibrations_shows_no_boxes_of_them(room, tmp_path):
    out = tmp_path / "run"
    assert main(["run", str(room), *options_of(detections_in(room)), "--out", str(out), "--quiet"]) == 0
    for source in open_run(out).spec.cameras.values():
        (room.parent / source.calibration).unlink(missing_ok=True)
    header, columns, _ = page_of(out)
    assert [(entry["at"], entry["field"]) for entry in header["cameras"]] == [(None, [])] * 2
    assert "0/ground" in columns and not any("/cameras/" in name for name in columns)


WRONG = {
    "no_name": (["--detections", "{south}"], "CAMERA=... is needed with one of south, east"),
    "unknown": (["--detections", "soth={south}"], "nearest: south"),
    "missing": (["--detections", "south={south}"], "neither a source nor detections of the camera east"),
    "twice": (
        ["--detections", "south={south}", "--detections", "south={east}"],
        "the second one of camera south",
    ),
    "one_file": (
        ["--detections", "south={south}", "--detections", "east={south}"],
        "the source of two cameras, south and east",
    ),
    "swapped": (
        ["--detections", "south={east}", "--detections", "east={south}"],
        "of 640x480 px, and the frames have 800x480 px",
    ),
    "start_box": (
        ["--detections", "south={south}", "--detections", "east={east}", "--init", "1,2,30,40"],
        "a box is of one image; allowed: where each camera sees it, 'south=X,Y east=X,Y'",
    ),
}


@pytest.mark.parametrize(("options", "said"), WRONG.values(), ids=[*WRONG])
def test_wrong_sources_are_refused(room, tmp_path, capsys, options, said):
    files = {camera: str(path) for camera, path in detections_in(room).items()}
    out = tmp_path / "run"
    assert main(["run", str(room), *(one.format(**files) for one in options), "--out", str(out)]) != 0
    assert said in capsys.readouterr().err
    assert not (out / "journal.jsonl").exists()


def test_names_of_cameras_for_one_image_are_refused(tmp_path):
    path = write_graph(tmp_path, ("south",))
    with pytest.raises(ValueError, match="the graph room has not several cameras"):
        track(path, {"south": "south.mp4"}, detections={"south": "boxes.txt"})


def outputs_of(run):
    own = {"manifest.json", "timings.jsonl"}
    return {path.name: path.read_bytes() for path in run.iterdir() if path.name not in own and path.is_file()}


@pytest.mark.parametrize(("stop_after", "cost"), [(1, None), (7, None), (7, 0.5), (COUNT - 1, 1)])
def test_a_run_that_was_broken_off_goes_on_with_equal_bytes(room, tmp_path, stop_after, cost):
    if cost is not None:
        room.write_text(json.dumps({**json.loads(room.read_text()), "adapt": {"cost_per_step": cost}}))
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    for _ in track(room, None, detections=detections_in(room), out=whole, tracks_csv=True):
        pass
    results = track(room, None, detections=detections_in(room), out=broken, tracks_csv=True)
    for _ in range(stop_after):
        next(results)
    results.close()
    assert len(list(resume(broken))) == COUNT - stop_after
    assert outputs_of(broken) == outputs_of(whole)
    assert main(["verify", str(broken)]) == 0


def test_a_run_does_not_go_on_with_other_detections(room, tmp_path):
    out = tmp_path / "run"
    results = track(room, None, detections=detections_in(room), out=out)
    next(results)
    results.close()
    boxes = detections_in(room)["east"]
    boxes.write_text(boxes.read_text().replace("0.9", "0.8"))
    with pytest.raises(ResumeError, match=r"boxes.txt.* now "):
        list(resume(out))


def test_start_and_end_are_steps(room, tmp_path):
    out = tmp_path / "run"
    named = options_of(detections_in(room))
    run = [
        "run",
        str(room),
        *named,
        "--start",
        "3",
        "--end",
        "9",
        "--tracks-csv",
        "--out",
        str(out),
        "--quiet",
    ]
    assert main(run) == 0
    rows = list(csv.DictReader((out / "tracks.csv").open()))
    assert [int(row["frame"]) for row in rows][-1] == 8
    cameras = list(csv.DictReader((out / "cameras.csv").open()))
    assert min(int(row["frame"]) for row in cameras) in range(3, 9)
    assert float(rows[-1]["time_s"]) == pytest.approx(8 / 20)


def test_a_live_stream_is_refused(room):
    from bayesnet_track.sources.several import SeveralSources

    class Live:
        description, is_live = "rtsp://camera", True

        def close(self):
            pass

    with pytest.raises(SourceError, match="a live stream as the source of camera south"):
        SeveralSources({"south": Live()})


def test_detections_of_one_camera_only_are_refused(room, tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    width, height = CAMERAS["east"].size
    for frame in range(2):
        (images / f"{frame}.pgm").write_bytes(b"P5 %d %d 255\n" % (width, height) + bytes(width * height))
    with pytest.raises(ValueError, match=r"no detections of east are given; .*detections=.\"east\": FILE"):
        track(room, {"east": images}, detections={"south": detections_in(room)["south"]})


def test_a_target_that_the_first_camera_cannot_see_has_no_box(tmp_path):
    behind = np.array([-13.0, 9.0])  # the camera `west`
    assert not np.isfinite(boxes_of("west", behind)).any()
    files = {}
    for camera in ("west", "east"):
        (tmp_path / camera).mkdir()
        width, height = CAMERAS[camera].size
        (tmp_path / camera / "seqinfo.ini").write_text(
            f"[Sequence]\nimWidth={width}\nimHeight={height}\nframeRate=10\nseqLength={COUNT}\n"
        )
        places = [behind, PLACE] if camera == "east" else [PLACE]
        lines = [
            f"{frame + 1},-1,{x - (w - 1) / 2},{y - (h - 1) / 2},{w},{h},0.9,-1,-1,-1"
            for frame in range(COUNT)
            for x, y, w, h in (boxes_of(camera, place)[0] for place in places)
        ]
        files[camera] = tmp_path / camera / "boxes.txt"
        files[camera].write_text("\n".join(lines) + "\n")
    out = tmp_path / "run"
    *_, last = track(write_graph(tmp_path, ("west", "east")), None, detections=files, out=out)
    assert len(last.targets) == 2
    assert ",-10000." not in (out / "tracks.txt").read_text() + (out / "tracks.csv").read_text()
    rows = [row for row in csv.DictReader((out / "tracks.csv").open()) if float(row["x_m"]) < -10.0]
    assert rows
    assert all(row[name] == "" for row in rows for name in "xywh")
    assert main(["export", str(out), "--format", "mot", "--out", str(tmp_path / "mot.txt")]) == 0
    exported, own = (np.loadtxt(path, delimiter=",") for path in (tmp_path / "mot.txt", out / "tracks.txt"))
    np.testing.assert_allclose(exported, own, atol=1e-5)


def test_reports_are_in_metres(room, tmp_path, capsys):
    out = tmp_path / "run"
    named = options_of(detections_in(room))
    assert main(["run", str(room), *named, "--out", str(out)]) == 0
    assert re.search(r"UD 0\.\d{4} m² \| tracking", capsys.readouterr().err)
    assert main(["log", str(out), "--why", "9"]) == 0
    assert re.search(r"UD +person 0\.\d+ m², view.east [\d.]+ px²", capsys.readouterr().out)
    advice = advise(open_run(out), Finding("1", "measures closer", "wide", "seen.south"))
    assert advice["try"].endswith("person.motion.constant_velocity.sd_velocity=0.25")


def test_the_clock_of_a_camera_is_reported_when_the_run_ends(room, tmp_path):
    graph = json.loads(room.read_text())
    graph["cameras"]["east"]["clock"] = {"offset_s": {"sd": 0.2}}
    room.write_text(json.dumps(graph))
    steps = list(track(room, None, detections=detections_in(room), out=tmp_path / "run"))
    events = open_run(tmp_path / "run").events
    last = [event for event in events if isinstance(event, ClockLearnt)][-1]
    state = steps[-1].targets[0].state
    assert (last.frame, last.camera) == (COUNT - 1, "east")
    assert last.offset_s == pytest.approx(state["view.east.clock_s"])
    assert last.sd_s == pytest.approx(state["view.east.clock_s_sd"])
    assert abs(last.offset_s) < 3 * last.sd_s < 0.3


def test_frames_that_lie_on_their_side_are_named(room):
    height, width = CAMERAS["east"].size
    (room.parent / "east" / "seqinfo.ini").write_text(
        f"[Sequence]\nimWidth={width}\nimHeight={height}\nframeRate=10\nseqLength=1\n"
    )
    with pytest.raises(StartError, match="filmed upright, the other on its side"):
        list(track(room, None, detections=detections_in(room)))

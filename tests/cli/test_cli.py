"""The command line: every command, every exit code, and what it says when something is wrong."""

import copy
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import webbrowser
import xml.etree.ElementTree as ET
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import jsonschema
import numpy as np
import pytest
import yaml

from bayesnet_track import open_run
from bayesnet_track.cli import main as commands
from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import EXAMPLES, EXIT_CODES, GROUPS, make_parser
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.step import step
from bayesnet_track.graphs import find_graph, graph_names
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.numerics.compile_watch import WATCH, CompileWatch
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.runtime.checkpoints.standing import standing
from bayesnet_track.runtime.recording.exports import as_csv
from bayesnet_track.runtime.stop import Terminated
from bayesnet_track.sources.scenes import make_scene, scene_names

ROOT = Path(__file__).parents[2]
RUN_FILES = {
    ".lock",
    "journal.jsonl",
    "frames.npy.gz",
    "tracks.txt",
    "timings.jsonl",
    "graph.yaml",
    "run.json",
    "manifest.json",
}
BOX = "20,14,16,12"


def pictures(count=8, size=(72, 56)):
    """An orange box on noise; its corner is at (20 + 2 n, 14)."""
    rng = np.random.default_rng(5)
    background = rng.integers(60, 100, (size[1], size[0], 3), dtype=np.uint8)
    for number in range(count):
        image = background.copy()
        image[14:26, 20 + 2 * number : 36 + 2 * number] = (30, 130, 240)
        yield image


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number, image in enumerate(pictures()):
        cv2.imwrite(str(folder / f"{number:04d}.png"), image)
    truth = "".join(f"{20 + 2 * n},14,16,12\n" for n in range(8))
    (folder / "groundtruth.txt").write_text(truth)
    return folder


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "in.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 72, 56, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 25)
        stream.codec_context.gop_size = 2
        for image in pictures():
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    return path


@pytest.fixture(scope="module")
def two_plates(tmp_path_factory):
    graph = yaml.safe_load(find_graph("two_squares").read_text())
    plate = graph["targets"].pop("square")
    graph |= {"name": "pair", "targets": {"ball": plate, "bat": copy.deepcopy(plate)}}
    path = tmp_path_factory.mktemp("graph") / "pair.yaml"
    path.write_text(yaml.safe_dump(graph, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def demo_run(tmp_path_factory):
    """The first 60 frames of the demo: motion goes off and comes back twice."""
    out = tmp_path_factory.mktemp("demo") / "run"
    assert main(["demo", "--end", "60", "--quiet", "--out", str(out)]) == 0
    return out


@pytest.fixture
def cli(capsys):
    """One line of arguments -> (exit code, what it printed, what it complained of)."""

    def call(line="", *more):
        capsys.readouterr()
        try:
            code = main([*shlex.split(line), *map(str, more)])
        except SystemExit as end:
            code = end.code
        out, err = capsys.readouterr()
        return code, out, err

    return call


def lines_of(path):
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    return text.splitlines()


def column(path, name):
    head, *rows = (line.split(",") for line in as_csv(open_run(path)).splitlines())
    return [row[head.index(name)] for row in rows]


# ------------------------------------------------------------------------------------ help and version


def test_help_names_every_command_and_exit_code(cli):
    code, out, _ = cli("--help")
    assert code == 0
    commands = make_parser().commands.choices
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(commands)
    for command in commands:
        assert re.search(rf"^  {command} +\S.*\n +\$ bayesnet-track {command}", out, re.MULTILINE)
    assert "example:\n  bayesnet-track run general" in cli("run --help")[1]
    codes = [int(number) for number in re.findall(r"^  (\d+) ", out.split("exit codes:")[1], re.MULTILINE)]
    assert codes == [0, 1, 2, 3, 4, 5, 6, 130, 143]


@pytest.mark.parametrize("command", EXAMPLES)
def test_the_example_of_a_command_is_one(command):
    words = shlex.split(EXAMPLES[command].partition(" > ")[0])
    assert make_parser().parse_args(words).command == command


def test_the_page_has_the_same_exit_codes():
    table = re.findall(
        r"^\| (\d) \| (.*) \|$", (ROOT / "docs/output_files.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    lines = EXIT_CODES.replace("\n       ", " ")  # one that goes on
    assert table == re.findall(r"^  (\d)    (.*)$", lines, re.MULTILINE)


def test_a_plot_has_every_agent_and_replaces_nothing_unasked(cli, demo_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli(f"plot {demo_run}")[:2] == (0, "wrote run.svg\n")
    picture = (tmp_path / "run.svg").read_text("utf-8")
    assert all(f">{agent}<" in picture for agent in ("color", "motion"))
    code, _, err = cli(f"plot {demo_run}")
    assert (code, err) == (6, "bayesnet-track plot: run.svg: it is there already; --overwrite replaces it\n")
    assert cli(f"plot {demo_run} --target 1 --overwrite")[0] == 0


def test_a_word_selects_lines_of_the_list(cli):
    code, out, _ = cli("list TEXTURE")
    titles = [line.partition(" (")[0].rstrip(":") for line in out.splitlines() if line[0] != " "]
    assert code == 0 and "cues" in titles
    assert all("texture" in line.lower() for line in out.splitlines() if line[0] == " ")


def test_without_a_command_it_shows_help_and_fails(cli):
    code, out, _ = cli()
    assert code == 2 and out.startswith("usage: bayesnet-track")


def test_version(cli):
    code, out, _ = cli("--version")
    assert code == 0 and re.fullmatch(r"bayesnet-track \d+\.\d+\.\d+\S*\n", out)


# ------------------------------------------------------------------------------------ demo


DEMOS = ("two_squares", "ball_between_children", "carried_box", "person_and_board", "person_color_stereo")
"""One of every kind of graph: several targets, parts, shapes, two eyes."""


@pytest.mark.parametrize(
    "scene", [pytest.param(one, marks=() if one in DEMOS else pytest.mark.slow) for one in scene_names()]
)
def test_every_scene_is_a_demo(cli, tmp_path, scene):
    out = tmp_path / "run"
    code, said, progress = cli(f"demo {scene} --end 4 --out", out)
    assert code == 0
    # A street has detections, too, and its graph asks for speeds.
    further = {"tracks.csv", "queries.csv"} if scene == "street" else set()
    assert {file.name for file in out.iterdir()} == RUN_FILES | {"video.mkv", "truth.txt"} | further
    if scene == "street":
        assert f"{out}: 4 frames in " in said and "mota " in said
        return
    assert list(dict.fromkeys(column(out, "frame"))) == ["0", "1", "2", "3"]
    assert len(column(out, "frame")) == 4 * len(set(column(out, "target")))
    truth = np.loadtxt(out / "truth.txt", delimiter=",")
    np.testing.assert_array_equal(truth, make_scene(scene).truth[:4])
    with av.open(str(out / "video.mkv")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 4
    assert f"{out}: 4 frames in " in said and "what was decided, and why:\nrun of " in said
    assert "scored_frames  4 " in said and f"`bayesnet-track log {out} --why 3`" in said
    assert progress.splitlines()[-1].startswith("frame 4/4 | ")  # before it others, if the machine is slow


def test_a_demo_replaces_its_default_folder_only(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert cli("demo --end 2 --quiet")[0] == 0
    assert (tmp_path / "runs/two_squares/journal.jsonl").is_file()
    code, _, err = cli("demo --end 2 --quiet --out runs/two_squares")
    assert code == 6 and "a run is there already" in err
    assert cli("demo --end 2 --quiet --out runs/two_squares --overwrite")[0] == 0


def test_a_demo_takes_another_graph_and_seed(cli, tmp_path):
    assert cli("demo --end 3 --quiet --graph general --seed 4 --out", tmp_path / "run")[0] == 0
    started = open_run(tmp_path / "run").events[0]
    assert (started.graph, started.seed, started.source) == ("general", 4, "scene:two_squares")


# ------------------------------------------------------------------------------------ run


def test_a_run_that_ends_before_resume_has_its_lock_needs_nothing(cli, tmp_path, monkeypatch):
    out = tmp_path / "run"
    assert cli("demo gray_square --end 2 --quiet --out", out)[0] == 0
    before = (out / "journal.jsonl").read_bytes()
    assert "it is finished" in cli("resume", out)[1]
    # Before it has the lock, the command sees a run that goes on.
    finished = standing(out)
    monkeypatch.setattr(
        "bayesnet_track.runtime.checkpoints.standing.standing",
        lambda folder: replace(finished, is_finished=False),
    )
    assert cli("resume", out)[0] == 0
    assert (out / "journal.jsonl").read_bytes() == before


def test_what_resume_cannot_store_is_told_at_the_start(cli, images, tmp_path):
    graph = tmp_path / "opaque.yaml"
    graph.write_text(
        "bayesnet: 1\nname: opaque\ntargets:\n  box:\n    nodes:\n"
        "      box: {motion: {random_walk: {sd_px: {x: 3, y: 3}}}}\n"
        "      mil: {parent: box, agent: opencv_tracker}\n"
    )
    line = f"run {graph} --source {images} --init {BOX} --end 2 --quiet --out"
    code, _, err = cli(line, tmp_path / "run")
    assert code == 0 and "what mil keeps cannot be stored: `resume` would begin this run anew" in err
    assert cli(f"{line} {tmp_path / 'no'} --checkpoint-every 0")[2] == ""


def test_run_on_a_folder_of_images(cli, images, tmp_path):
    out = tmp_path / "run"
    code, said, progress = cli(f"run general --source {images} --init {BOX} --out", out)
    assert code == 0
    assert {file.name for file in out.iterdir()} == RUN_FILES
    assert re.fullmatch(
        rf"{re.escape(str(out))}: 8 frames in \d+\.\d s \(\d+ frames per second after the first.*\), "
        r"\d+ reconfigurations?\n",
        said,
    )
    assert re.fullmatch(
        r"frame 8/8 \| [\d.]+ fps \| 0:00 left \| [a-z, ]+ \| UD \d+ px² \| tracking\n"
        r"next: `bayesnet-track report .* --open` shows .*\n",
        progress,
    )
    assert [len(lines_of(out / name)) for name in ("tracks.txt", "timings.jsonl")] == [8] * 2
    assert len(open_run(out).metrics) == 8
    fixed = "the graph has no rule that switches agents of target: all of them look in every frame"
    assert fixed in cli("log", out)[2] and fixed not in cli(f"log {out} --kind net_started")[2]
    assert [float(v) for v in lines_of(out / "tracks.txt")[0].split(",")[:6]] == [1, 1, 20, 14, 16, 12]
    # It moves by two pixels a frame; a tracker that stands still would be 14 px off in the last.
    assert abs(float(column(out, "x")[-1]) - 34) < 5


def test_run_on_a_video_with_an_annotated_one(cli, video, tmp_path):
    out = tmp_path / "run"
    code, *_ = cli(f"run general --source {video} --init {BOX} --video --quiet --out", out)
    assert code == 0
    assert {file.name for file in out.iterdir()} == RUN_FILES | {"video.mkv"}
    assert float(column(out, "time_s")[-1]) == pytest.approx(7 / 25)
    with av.open(str(out / "video.mkv")) as container:
        frames = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    assert len(frames) == 8 and frames[0].shape == (56, 72, 3)
    assert np.abs(frames[0].astype(int) - next(pictures())).max() > 80  # something is drawn


def test_gray_images_are_tracked_by_what_is_not_colour(cli, images, tmp_path):
    folder = tmp_path / "gray"
    folder.mkdir()
    for path in images.glob("*.png"):
        cv2.imwrite(str(folder / path.name), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    out = tmp_path / "run"
    assert cli(f"run general --source {folder} --init {BOX} --quiet --out", out)[0] == 0
    assert open_run(out).events[0].has_color is False
    for metrics in open_run(out).metrics[1:]:
        assert metrics.status == "tracking" and max(metrics.strength.values()) > 0.1
    assert abs(float(column(out, "x")[-1]) - 34) < 5


def test_many_notices_are_cut_short(cli, images, tmp_path):
    folder = tmp_path / "holes"
    folder.mkdir()
    for number, image in enumerate(pictures(16)):
        path = folder / f"{number:02d}.png"
        path.write_bytes(b"") if number % 2 else cv2.imwrite(str(path), image)
    out = tmp_path / "run"
    code, said, err = cli(f"run general --source {folder} --init {BOX} --out", out)
    assert code == 5 and said.endswith(", the source is damaged\n")
    assert len(err.splitlines()) == 1 + 6 + 1  # progress, notices, the next command
    notices = len(cli(f"log {out} --kind source_damaged")[1].splitlines())
    gaps = len(cli(f"log {out} --kind frames_missing")[1].splitlines())
    assert (notices, gaps) == (8, 7)
    assert err.splitlines()[-2] == f"... and 10 more; `bayesnet-track log {out}` lists them all"


def test_several_targets_with_plates(cli, images, two_plates, tmp_path):
    out = tmp_path / "run"
    line = f"run {two_plates} --source {images} --init ball:{BOX} --init bat:40,30,10,10 --init ball:2,2,9,9"
    code, _, progress = cli(f"{line} --out", out)
    assert code == 0 and progress.startswith("frame 8/8 | ")
    assert column(out, "target") == ["1", "2", "3"] * 8
    started = [event for event in open_run(out).events if hasattr(event, "template")]
    assert [(event.target, event.template) for event in started] == [
        ("1", "ball"),
        ("2", "bat"),
        ("3", "ball"),
    ]
    assert {line.split(",")[1] for line in lines_of(out / "tracks.txt")} == {"1", "2", "3"}
    output = [line for line in cli("log", out)[1].splitlines() if line.startswith("frame ")]
    assert output and all(re.search(r"\b(ball 1|bat 2|ball 3)\b", line) for line in output)


@pytest.mark.parametrize("init", ["--init -3,14,16,12", "--init=-3,14,16,12", "--init ' -3, 14, 16, 12'"])
def test_a_start_box_may_lie_partly_outside(cli, images, tmp_path, init):
    assert cli(f"run general --source {images} {init} --end 2 --quiet --out", tmp_path / "run")[0] == 0
    assert float(column(tmp_path / "run", "x")[0]) == -3


def test_start_end_and_the_start_box_from_a_file(cli, images, tmp_path):
    out = tmp_path / "run"
    init = f"--init-from {images / 'groundtruth.txt'}"
    assert cli(f"run general --source {images} {init} --start 3 --end 6 --quiet --out", out)[0] == 0
    assert column(out, "frame") == ["3", "4", "5"]
    assert float(column(out, "x")[0]) == 26
    events = open_run(out).events
    assert (events[0].declared_frames, events[-1].frames, events[-1].complete) == (3, 3, True)


def test_a_run_with_another_value_in_the_graph(cli, images, tmp_path):
    line = f"run general --source {images} --init {BOX} --end 2 -q -o {tmp_path / 'run'}"
    assert cli(f"{line} --set target.belief.particles.size=77")[0] == 0
    graph = yaml.safe_load((tmp_path / "run/graph.yaml").read_text())
    assert graph["targets"]["target"]["nodes"]["target"]["belief"]["particles"]["size"] == 77
    code, _, err = cli(f"{line} --overwrite --set target.belief.particles.sise=77")
    assert code == 3 and "target: unknown key 'sise'" in err and "nearest: size" in err
    assert cli(f"{line} --overwrite --set size")[0] == 2


def test_an_earlier_run_is_replaced_only_when_asked(cli, images, tmp_path):
    line = f"run general --source {images} --init {BOX} --end 2 --quiet --out {tmp_path / 'run'}"
    assert [cli(line)[0], cli(line)[0], cli(f"{line} --overwrite")[0]] == [0, 6, 0]


def test_progress_as_json(cli, images, tmp_path):
    code, _, err = cli(f"run general --source {images} --init {BOX} --log-json --out", tmp_path / "run")
    last = json.loads(err.splitlines()[-1])
    assert code == 0 and (last["progress"], last["total"], last["status"]) == (8, 8, "tracking")
    assert "color" in last["active"] and last["ud_px2"] > 0


def test_quiet_is_quiet(cli, images, tmp_path):
    line = f"run general --source {images} --init {BOX} --end 2 --quiet --out"
    assert cli(line, tmp_path / "run") == (0, "", "")
    assert cli("demo two_squares --end 4 -q --out", tmp_path / "demo") == (0, "", "")


def test_json_is_one_object_that_sums_the_run_up(cli, images, tmp_path):
    code, out, _ = cli(f"run general --source {images} --init {BOX} --json -o", tmp_path / "run")
    found = json.loads(out)
    assert code == 0 and (found["run"], found["frames"]) == (str(tmp_path / "run"), 8)
    assert found["complete"] is True and found["reason"] == "end_of_source" and found["lost_frames"] == 0
    code, out, _ = cli("resume --json", tmp_path / "run")
    assert code == 0 and json.loads(out)["complete"] is True
    code, out, _ = cli("demo two_squares --end 4 --json --out", tmp_path / "demo")
    assert code == 0 and json.loads(out)["scores"]["mean_iou"] > 0.5


def test_verbose_prints_decisions_when_they_are_made(cli, tmp_path):
    code, _, err = cli("demo two_squares --end 10 -v --out", tmp_path / "run")
    assert code == 0 and "frame 6, square 1: UD " in err and "fps" not in err


@pytest.mark.parametrize(("option", "code", "frames"), [("", 5, 4), (" --on-resize rescale", 0, 8)])
def test_a_change_of_size_stops_or_is_rescaled(cli, images, tmp_path, option, code, frames):
    folder = tmp_path / "sizes"
    folder.mkdir()
    for number, image in enumerate(pictures()):
        cv2.imwrite(str(folder / f"{number}.png"), image if number < 4 else cv2.resize(image, (144, 112)))
    out = tmp_path / "run"
    found, said, err = cli(f"run general --source {folder} --init {BOX} {option} --out", out)
    assert found == code and len(column(out, "frame")) == frames
    action = "the run stops" if code else "they are scaled to the first frame's size"
    assert f"\nframe 4: the frame size changes to 144x112; {action}\n" in err
    assert ("stopped where the frames change size" in said) == bool(code)


NOTICE_COMPILING = commands.notice_compiling


@pytest.mark.parametrize(
    ("line", "output"),
    [
        ("list", f"{commands.COMPILING}\n"),
        ("demo --quiet", ""),
        ("demo --log-json", ""),
        ("score x --json", ""),
    ],
)
def test_it_is_said_once_that_kernels_are_compiled(cli, monkeypatch, line, output):
    def command(options):
        for kernel in ("one", "two"):
            WATCH.begins(kernel)
            WATCH.ends(kernel)
        return 0

    monkeypatch.setattr(commands, "COMMANDS", dict.fromkeys(commands.COMMANDS, command))
    monkeypatch.setattr(commands, "notice_compiling", NOTICE_COMPILING)
    assert cli(line) == (0, "", output)
    monkeypatch.setattr(commands, "COMMANDS", dict.fromkeys(commands.COMMANDS, lambda options: 0))
    assert cli(line) == (0, "", ""), "nothing is compiled"


def test_the_rate_is_without_the_first_frame_and_the_seconds_of_compiling(cli, images, tmp_path, monkeypatch):
    """As at the first run: 20 seconds of compiling in the first frame, 9 in the second, none in a rate."""
    watch, now = CompileWatch(), [0.0]

    def takes(seconds, compiling, work):
        def slowly(*arguments):
            now[0] += seconds + compiling
            watch.seconds += compiling
            return work(*arguments)

        return slowly

    monkeypatch.setattr("bayesnet_track.runtime.run.start_targets", takes(100.0, 20.0, start_targets))
    monkeypatch.setattr("bayesnet_track.runtime.run.step", takes(0.125, 9.0, step))
    monkeypatch.setattr("bayesnet_track.runtime.run.WATCH", watch)
    clock = SimpleNamespace(perf_counter=lambda: now[0])
    monkeypatch.setattr("bayesnet_track.runtime.run.time", clock)
    code, said, _ = cli(f"run general --source {images} --init {BOX} --end 2 --out", tmp_path / "run")
    assert code == 0
    assert "2 frames in 129.1 s (8 frames per second after the first, 29.0 s of compiling)" in said


@pytest.mark.slow
def test_the_first_run_says_that_it_compiles_and_the_second_one_does_not(tmp_path):
    """The ball's scene needs few kernels."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for first in (True, False):
        out = tmp_path / f"run {first}"
        line = [
            sys.executable,
            "-m",
            "bayesnet_track",
            "demo",
            "flying_ball",
            "--end",
            "6",
            "--out",
            str(out),
        ]
        done = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
        assert done.stderr.count(commands.COMPILING) == first
        assert (" s of compiling" in done.stdout) == first


# ------------------------------------------------------------------------------------ exit codes


def test_exit_1_is_an_error_of_the_program(cli, monkeypatch):
    def broken(options):
        raise ValueError("operands could not be broadcast")

    monkeypatch.setitem(commands.COMMANDS, "list", broken)
    code, _, err = cli("list")
    assert code == 1
    assert "Traceback" in err and "ValueError: operands could not be broadcast" in err
    assert err.endswith("this is an error in the program; please report the lines above\n")


@pytest.mark.parametrize(("interrupt", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
def test_interrupts_before_the_first_frame(cli, monkeypatch, interrupt, code):
    def interrupted(options):
        raise interrupt

    monkeypatch.setitem(commands.COMMANDS, "list", interrupted)
    assert cli("list") == (code, "", "")


SOURCES = "a video file, a folder of images, a glob of images, a camera index such as 0, an http or rtsp URL"

MISTAKES = {
    # wrong arguments
    "demo two_square": (
        2,
        "bayesnet-track demo: no scene is called 'two_square'; there are "
        f"{', '.join(scene_names())}; did you mean two_squares?",
    ),
    "run general --source {images} --out {out} --init 1,2,3": (
        2,
        "bayesnet-track run: --init '1,2,3': four numbers X,Y,W,H are needed (top-left corner, px)",
    ),
    "run general --source {images} --out {out} --init 1,2,3,nan": (
        2,
        "bayesnet-track run: start box (1.0, 2.0, 3.0, nan): four finite numbers x,y,w,h are needed",
    ),
    "run general --source {images} --out {out} --init 1,2,0,5": (
        2,
        "bayesnet-track run: start box 1,2,0,5: width and height must be at least 1 px",
    ),
    "run general --source {images} --out {out} --init 72,2,5,5": (
        2,
        "bayesnet-track run: start box 72,2,5,5 lies outside the 72x56 frame; x,y is the top-left corner",
    ),
    "run general --source {images} --out {out} --init 1,1,1e308,1e308": (
        2,
        "bayesnet-track run: start box 1,1,1e+308,1e+308: at most 10 times the 72x56 frame is allowed, "
        "720x560 px",
    ),
    "run general --source {images} --out {out} --init-from {wrong}/wide.txt": (
        2,
        "bayesnet-track run: start box 1,1,1e+100,9: at most 10 times the 72x56 frame is allowed, 720x560 px",
    ),
    "detect color_backprojection --source {images} --learn 1,1,1e308,1e308": (
        2,
        "bayesnet-track detect: --learn '1,1,1e308,1e308': start box 1,1,1e+308,1e+308: at most 10 times the "
        "72x56 frame is allowed, 720x560 px",
    ),
    "run general --source {images} --out {out} --init targt:1,2,5,5": (
        2,
        "bayesnet-track run: no plate 'targt' in graph general; there are target; nearest: target",
    ),
    "run general --source {images} --out {out} --init 1,2,5,5 --start 3 --end 3": (
        2,
        "bayesnet-track run: --end 3 must be greater than --start 3",
    ),
    "run general --source {images} --out {out} --init-from {images}/none.txt": (
        2,
        "bayesnet-track run: --init-from {images}/none.txt: No such file or directory; expected a text "
        "file with one box x,y,w,h per line",
    ),
    "run general --source {images} --out {out} --init-from {wrong}/binary": (
        2,
        "bayesnet-track run: --init-from {wrong}/binary: not a text file (a JPEG image); expected a text "
        "file with one box x,y,w,h per line",
    ),
    "run general --source {images} --out {out} --init-from {wrong}/none --seeds 2": (
        2,
        "bayesnet-track run: --init-from {wrong}/none: No such file or directory; expected a text file with "
        "one box x,y,w,h per line",
    ),
    "run general --source {images} --out {out} --init 1,2,5,5 --truth {wrong}/none --seeds 2": (
        2,
        "bayesnet-track run: --truth {wrong}/none: No such file or directory; expected a text file with one "
        "box x,y,w,h per line, or MOT lines",
    ),
    "run general --init 1,2,3,4 --out {out}": (
        2,
        "bayesnet-track run: no source: a video, a folder of images; without one, a file of detections, "
        "whose times then stand for frames",
    ),
    "run kalman_detections --source {images} --out {out} --detections {wrong}/none": (
        2,
        "bayesnet-track run: --detections {wrong}/none: No such file or directory; expected a text "
        "file with MOT lines (frame,id,left,top,width,height,confidence,...), JSON Lines, or a CSV "
        "of what sensors measured",
    ),
    "run kalman_detections --source {images} --out {out} --detections {wrong}/binary": (
        2,
        "bayesnet-track run: --detections {wrong}/binary: not a text file (a JPEG image); expected a text "
        "file with MOT lines (frame,id,left,top,width,height,confidence,...), JSON Lines, or a CSV "
        "of what sensors measured",
    ),
    "batch general --list {wrong}/binary --out {out}": (
        2,
        "bayesnet-track batch: {wrong}/binary: not a text file (a JPEG image)",
    ),
    "run general --source {images} --out {out} --init-from {images}/groundtruth.txt --start 9": (
        2,
        "bayesnet-track run: {images}/groundtruth.txt: no box for frame 9; it has boxes for frames 0 to 7",
    ),
    "run general --source {images} --out {out} --init-from {wrong}/absent.txt": (
        2,
        "bayesnet-track run: {wrong}/absent.txt: the target is absent in frame 0; choose another --start",
    ),
    "run general --source {images} --out {out} --init-from {wrong}/words.txt": (
        2,
        "bayesnet-track run: {wrong}/words.txt:1: a header line (no,boxes,in,here) in which no column is "
        "called left, top, width or right, height or bottom; rename the columns (frame,id,left,top,width,"
        "height,confidence,class, or x1,y1,x2,y2 for corners), or remove the line",
    ),
    "run general --source {images} --init 1,2,5,5 --out {out}/x.mp4": (
        2,
        "bayesnet-track run: --out {out}/x.mp4: this is the folder of the run; --out {out}/x --video mp4 "
        "writes {out}/x/video.mp4",
    ),
    "graph general --target targt": (
        2,
        "bayesnet-track graph: no target 'targt'; there are target; nearest: target",
    ),
    "log {demo} --frames 5:x": (
        2,
        "bayesnet-track log: --frames '5:x': A:B with A < B is needed (or :B, or A:, or one A)",
    ),
    "log {demo} --frames 5..7": (
        2,
        "bayesnet-track log: --frames '5..7': A:B with A < B is needed (or :B, or A:, or one A)",
    ),
    "log {demo} --frames 7:5": (
        2,
        "bayesnet-track log: --frames '7:5': A:B with A < B is needed (or :B, or A:, or one A)",
    ),
    "log {demo} --node colour": (
        2,
        "bayesnet-track log: no node 'colour' in the run's graph; there are square, color, motion; "
        "nearest: color",
    ),
    "log {demo} --why 60": (2, "bayesnet-track log: frame 60 is not in this run; it has frames 0 to 59"),
    "log {demo} --why 3 --json --node color": (
        2,
        "bayesnet-track log: --why explains one frame; leave out --node and --json",
    ),
    "log {demo} --why 3 --target 2": (2, "bayesnet-track log: no target '2' in this run; there are 1"),
    "log {demo} --target 2 --json": (2, "bayesnet-track log: no target '2' in this run; there are 1"),
    "log {demo} --target 1 --node colour": (
        2,
        "bayesnet-track log: no node 'colour' in the run's graph; there are square, color, motion; "
        "nearest: color",
    ),
    "score {wrong}/untrue": (
        2,
        "bayesnet-track score: no ground truth at {wrong}/untrue/truth.txt; name one with --truth FILE",
    ),
    "score {demo} --target 2": (2, "bayesnet-track score: {demo}: no target '2'; there are 1"),
    "score {demo} --truth {wrong}/words.txt": (
        2,
        "bayesnet-track score: {wrong}/words.txt:1: a header line (no,boxes,in,here) in which no column is "
        "called left, top, width or right, height or bottom; rename the columns (frame,id,left,top,width,"
        "height,confidence,class, or x1,y1,x2,y2 for corners), or remove the line",
    ),
    # a wrong graph
    "run generl --source {images} --out {out} --init 1,2,3,4": (
        3,
        "generl:1:1: graph: no installed graph of this name; allowed: a name that `bayesnet-track list` "
        "prints, or a path to a file; nearest: general",
    ),
    "validate {wrong}/none.yaml": (
        3,
        "{wrong}/none.yaml:1:1: graph: cannot be read: No such file or directory",
    ),
    "demo --graph {wrong}/bad.yaml": (
        3,
        "{wrong}/bad.yaml:1:1: graph: key 'targets' is missing; allowed: a mapping, each a mapping with "
        "state, birth, merge_duplicates, death, reidentify, existence, identity, associate, nodes\n"
        "  1 | bayesnet: 1\n    | ^\n"
        "{wrong}/bad.yaml:3:1: graph: unknown key 'targts'; allowed: bayesnet, name, about, constants, "
        "inputs, cameras, adapt, targets, joins, queries; nearest: targets\n  3 | targts: {{}}\n    | ^",
    ),
    # a source, or a run, that cannot be read
    "run general --source {wrong}/nothing --out {out} --init 1,2,3,4": (
        4,
        f"bayesnet-track run: source '{{wrong}}/nothing': no such file or folder; allowed: {SOURCES}; "
        "check the name",
    ),
    "run general --source {wrong}/words.txt --out {out} --init 1,2,3,4": (
        4,
        "bayesnet-track run: source '{wrong}/words.txt': it is no video, and as a file of boxes: "
        "{wrong}/words.txt:1: a header line (no,boxes,in,here) in which no column is called left, top, width "
        "or right, height or bottom; rename the columns (frame,id,left,top,width,height,confidence,class, or "
        "x1,y1,x2,y2 for corners), or remove the line; allowed: a video file, a folder of images, a glob of "
        "images, a camera index such as 0, an http or rtsp URL; give a video, or mend the file",
    ),
    "run general --source http://localhost/x.mp4 --out {out} --init 1,2,3,4": (
        4,
        "bayesnet-track run: source 'http://localhost/x.mp4': it is on the network; allowed: network sources "
        "with --allow-network; add that",
    ),
    "log {wrong}/nothing": (
        4,
        "bayesnet-track log: {wrong}/nothing: not a run directory: no such folder; "
        "runs in {wrong}: garbled, untrue",
    ),
    "plot {demo} --target 2 --out {out}": (2, "bayesnet-track plot: no target '2' in this run; there are 1"),
    "list nonsense": (
        2,
        "bayesnet-track list: no graph, scene, cue or detector with 'nonsense' in its name or description",
    ),
    "score {images}": (4, "bayesnet-track score: {images}: not a run directory: no journal.jsonl in it"),
    "log {wrong}/garbled": (
        4,
        'bayesnet-track log: {wrong}/garbled/journal.jsonl:1: no object with a key "event": []',
    ),
    # an output that cannot be written
    "run general --source {images} --init 1,2,5,5 --out {images}": (
        6,
        "bayesnet-track run: {images}: the folder is not empty and not a run; give a new or an empty folder",
    ),
    "graph general --svg {wrong}/none/net.svg": (
        6,
        "bayesnet-track graph: {wrong}/none/net.svg: cannot write: No such file or directory",
    ),
}


@pytest.fixture(scope="module")
def places(images, demo_run, tmp_path_factory):
    wrong = tmp_path_factory.mktemp("wrong")
    (wrong / "words.txt").write_text("no,boxes,in,here\n")
    (wrong / "binary").write_bytes(b"\xff\xd8\xff")
    (wrong / "wide.txt").write_text("1,1,1e100,9\n")
    (wrong / "absent.txt").write_text("nan,nan,nan,nan\n1,2,3,4\n")
    (wrong / "bad.yaml").write_text("bayesnet: 1\nname: bad\ntargts: {}\n")
    for name, text in (("untrue", ""), ("garbled", "[]\n")):
        (wrong / name).mkdir()
        (wrong / name / "journal.jsonl").write_text(text)
    return {"images": images, "demo": demo_run, "wrong": wrong}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_has_its_exit_code_and_one_clear_message(cli, places, tmp_path, line):
    places = {**places, "out": tmp_path / "run"}
    code, message = MISTAKES[line]
    found = cli(line.format(**places))
    assert found == (code, "", message.format(**places) + "\n")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("frobnicate", "bayesnet-track: no command 'frobnicate'\n`bayesnet-track --help` lists what"),
        ("rnu general", "bayesnet-track: no command 'rnu'; did you mean run?"),
        ("track video.mp4", "bayesnet-track: no command 'track'; did you mean run?"),
        (
            "completion bahs",
            "no SHELL 'bahs'; there are bash, zsh, fish; did you mean bash?",
        ),
        (
            "run general --source x -o y --vidoe",
            "track run: no option --vidoe; did you mean --video?",
        ),
        ("run general --source x --max-frames 9", "no option --max-frames; did you mean --start and --end?"),
        (
            "run general --sorce x -o y",
            "no option --sorce; did you mean --source?",
        ),
        (
            "run general --source x -o y --init 1 2 3 4",
            "unexpected '2 3 4'; write a value without spaces, as 1,2,3,4, or in quotes",
        ),
        ("run general --source x -o y --init 1, 2, 3, -4", "unexpected '2, 3, -4'; write a value without"),
        (
            "demo two words",
            "demo: unexpected 'words'; write a value without spaces",
        ),
        ("run g --source x --out y --executor ray", "no --executor 'ray'; there are serial, processes"),
        (
            "run general --init 1,2,3,4 --init-from z --source x --out y",
            "--init-from: not allowed with argument",
        ),
        ("demo --seed -1", "argument --seed: '-1': a whole number from 0 on is needed"),
        ("demo --end 0", "argument --end: '0': a whole number from 1 on is needed"),
        ("demo --end ٣", "argument --end: '٣': a whole number from 1 on is needed"),
        (
            "run g --source x --out y --init 1,2,3,4 --start -1",
            "argument --start: '-1': a whole number from 0",
        ),
        (
            "run g --source x --out y --init 1,2,3,4 --on-resize crop",
            "no --on-resize 'crop'; there are stop, rescale",
        ),
    ],
)
def test_what_the_parser_refuses(cli, line, message):
    code, _, err = cli(line)
    assert code == 2 and message in err and err.count("\n") == 2 and "--help` lists what there is" in err


@pytest.mark.parametrize(
    "probe", ["concat:{a}|{a}", "subfile,,start,0,end,9,,:{a}", "file:{a}", "pipe:0", "data:,x"]
)
def test_protocols_are_refused(cli, video, tmp_path, probe):
    source = probe.format(a=video)
    code, _, err = cli(f"run general --init {BOX} --out {tmp_path / 'run'} --source", source)
    assert code == 4 and "is refused; allowed: " in err
    assert not (tmp_path / "run").exists()


def test_exit_5_says_how_far_it_came_and_keeps_what_was_read(cli, video, tmp_path):
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(video.read_bytes()[: video.stat().st_size * 9 // 10])
    out = tmp_path / "run"
    code, said, err = cli(f"run general --source {cut} --init {BOX} --out", out)
    read = len(column(out, "frame"))
    assert code == 5 and 1 < read < 8
    assert f"the file is truncated: read {read} of 8 frames" in err
    assert said.endswith(", the source is truncated\n")
    ended = open_run(out).events[-1]
    assert (ended.frames, ended.complete, ended.reason) == (read, False, "source_truncated")


@pytest.mark.slow
@pytest.mark.parametrize("first", ["run {graph}", "run {graph} --executor processes"])
def test_a_run_in_which_no_agent_can_start_is_an_error_that_names_the_cause(cli, images, tmp_path, first):
    """Color alone, on a gray source: it was lost in every frame, and ended with 0."""
    graph = yaml.safe_load(find_graph("two_squares").read_text())
    nodes = graph["targets"]["square"]["nodes"]
    del nodes["motion"], nodes["square"]["adapt"]
    (tmp_path / "color.yaml").write_text(yaml.safe_dump(graph, sort_keys=False))
    (tmp_path / "gray").mkdir()
    for path in images.glob("*.png"):
        cv2.imwrite(str(tmp_path / "gray" / path.name), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    line = f"{first} --source {{gray}} --init {BOX} --init 1,1,9,9 --out {{out}}"
    code, _, err = cli(
        line.format(graph=tmp_path / "color.yaml", gray=tmp_path / "gray", out=tmp_path / "run")
    )
    why = "color: needs colour, and the source is gray"
    assert code == 2 and err == (
        "bayesnet-track run: no agent can start, so that nothing can be tracked; "
        f"target 1: {why}; target 2: {why}\n"
    )
    ended = open_run(tmp_path / "run").events[-1]
    assert (ended.frames, ended.complete, ended.reason) == (0, False, "error")
    code, said, _ = cli("log", tmp_path / "run")
    assert code == 0 and "color failed: needs colour, and the source is gray" in said


LONG = "x" * 300


@pytest.mark.parametrize(
    "line",
    [
        f"demo --end 2 --quiet --out {LONG}",
        f"run two_squares --source {{images}} --init {BOX} --out {LONG}",
        f"run two_squares --source {{images}} --init {BOX} --out {{out}} --rerun {LONG}.rrd",
        f"what-if {{demo}} --seed 1 --quiet --out {LONG}",
        f"what-if {{demo}} --seed 1 --quiet --out {{out}} --html {LONG}",
        f"batch two_squares --source {{images}} --init {BOX} --quiet --out {LONG}",
        f"report {{demo}} --frames none --out {LONG}.html",
        f"report {{demo}} --frames full --out {LONG}",
        f"compare {{demo}} {{demo}} --html {LONG}.html",
        f"export {{demo}} --format csv --out {LONG}",
        f"init {LONG}.yaml",
        f"graph two_squares --svg {LONG}.svg",
        f"detect motion --source {{images}} --out {LONG}",
        f"detect motion --source {{images}} --out {{out}} --save-video {LONG}.mkv",
        f"calibrate stereo {{images}} {{images}} --board 9x6 --square 0.1 --out {LONG}",
        f"fit two_squares --source {{images}} --truth {{images}}/groundtruth.txt --out {LONG}",
        f"learn-shape --masks {{images}} --min-support 1e-9 {LONG}.npz",
    ],
)
def test_a_name_too_long_for_an_output_is_told_as_such(cli, demo_run, images, tmp_path, line, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = cli(line.format(images=images, demo=demo_run, out=tmp_path / "out"))
    assert (code, "File name too long" in err, "Traceback" in err) == (6, True, False), err


def test_a_name_too_long_for_a_run_to_look_at_is_a_run_that_cannot_be_read(cli):
    for line in (f"log {LONG}", f"score {LONG}", f"export {LONG} --format csv"):
        code, _, err = cli(line)
        assert code == 4 and "File name too long" in err


def test_a_graph_in_a_folder_whose_name_is_too_long_cannot_be_read(cli):
    code, _, err = cli(f"validate {LONG}/g.yaml")
    assert code == 3 and "cannot be read: File name too long" in err


# ------------------------------------------------------------------------------------ graphs


def test_validate_installed_graphs(cli):
    code, out, err = cli(f"validate {' '.join(graph_names())}")
    assert code == 0 and err == ""
    assert "two_squares: ok (two_squares: 3 nodes, 2 of them agents)\n" in out
    assert len(out.splitlines()) == len(graph_names())


def test_validate_tells_all_errors_of_all_files(cli, places):
    bad = places["wrong"] / "bad.yaml"
    worse = places["wrong"] / "worse.yaml"
    worse.write_text("bayesnet: 2\nname: 'worse'\n")
    code, out, err = cli("validate", bad, "general", worse)
    assert code == 3
    assert out == "general: ok (general: 3 nodes, 2 of them agents)\n"
    assert len([line for line in err.splitlines() if line.startswith(f"{bad}:")]) == 2
    assert len([line for line in err.splitlines() if line.startswith(f"{worse}:")]) == 2
    assert all(re.match(r"\S+:\d+:\d+: graph: |  +\d* *\| |  hint: ", line) for line in err.splitlines())


def test_graph_prints_the_plan(cli):
    code, out, _ = cli("graph color_fusion")
    assert code == 0 and out.startswith("target square\n  plane ")
    assert "  join     color = pool(histogram^0.5, blobs^0.5)\n" in out


def test_graph_prints_the_density(cli):
    text, latex = cli("graph two_squares --formula")[1], cli("graph two_squares --latex")[1]
    assert "p(e_motion | square_t)" in text and "∝" in text
    assert r"\propto" in latex and latex.count("{") == latex.count("}")


def test_graph_draws_the_net(cli, tmp_path):
    code, out, _ = cli(f"graph color_fusion --svg {tmp_path / 'net.svg'} --png {tmp_path / 'net.png'}")
    assert code == 0 and out == f"wrote {tmp_path / 'net.svg'}\nwrote {tmp_path / 'net.png'}\n"
    words = "".join(ET.parse(tmp_path / "net.svg").getroot().itertext())
    assert all(node in words for node in ("square", "color", "histogram", "blobs", "motion"))
    assert cv2.imread(str(tmp_path / "net.png")).std() > 10


def test_graph_shows_every_plate_or_one(cli, two_plates):
    first, second = cli("graph --target ball", two_plates)[1], cli("graph --target bat", two_plates)[1]
    assert first.startswith("target ball\n") and second.startswith("target bat\n")
    assert cli("graph", two_plates)[1] == f"{first}\n{second}"
    assert cli("graph --formula", two_plates)[1].count("∝") == 2


def test_schema_is_draft_7_and_accepts_the_installed_graphs(cli):
    code, out, _ = cli("schema")
    schema = json.loads(out)
    assert code == 0
    jsonschema.Draft7Validator.check_schema(schema)
    for name in graph_names():
        jsonschema.Draft7Validator(schema).validate(yaml.safe_load(find_graph(name).read_text()))


def test_list_names_what_is_installed(cli):
    code, out, _ = cli("list")
    assert code == 0
    assert all(name in out for name in (*graph_names(), *scene_names(), *installed_cues()))
    assert re.search(r"^  general +Colour against", out, re.MULTILINE)
    folder = re.search(r"graphs \(in (.*); `bayesnet-track init", out)[1]
    assert (Path(folder) / "general.yaml").read_text(encoding="utf-8").startswith("# A sensible default")


# ------------------------------------------------------------------------------------ looking back


def test_log_tells_the_run_as_sentences(cli, demo_run):
    code, out, err = cli("log", demo_run)
    lines = out.splitlines()
    assert code == 0 and err == ""
    assert (
        lines[0].startswith("run of two_squares (")
        and lines[-1] == "run ended after 60 frames: end of source"
    )
    assert lines[1].startswith("frame 0: square 1 starts, centre")
    assert re.match(r"frame \d+: UD \S+ px² < \d+ for \d+ frames → motion off \(largest KL ", lines[2])
    assert len(lines) == len(open_run(demo_run).events)


def test_log_filters(cli, demo_run):
    events = [e for e in open_run(demo_run).events if type(e) in (Activated, Deactivated)]
    on = [event.frame for event in events if type(event) is Activated]
    first = on[0]
    assert type(events[0]) is Deactivated and events[0].frame < first

    def frames(filters):
        lines = cli(f"log {demo_run} {filters}")[1].splitlines()
        return [int(line.split(":")[0].split()[1]) for line in lines]

    assert frames("--kind activated") == on
    assert frames("--node motion") == [event.frame for event in events if event.node == "motion"]
    assert frames("--node square") == [event.frame for event in events]  # the node whose rules fired
    assert frames(f"--frames {first}") == frames(f"--frames {first}:{first + 1}") == [first]
    before = [event.frame for event in events if event.node == "motion" and event.frame < first]
    assert frames(f"--frames :{first} --node motion") == before
    assert frames(f"--frames {first}: --kind activated") == on


def test_log_as_json_is_the_journal(cli, demo_run):
    assert cli(f"log {demo_run} --json")[1] == (demo_run / "journal.jsonl").read_text()


def test_log_of_a_target_takes_the_other_filters(cli, demo_run):
    lines = (demo_run / "journal.jsonl").read_text().splitlines()
    assert cli(f"log {demo_run} --target 1 --json")[1].splitlines() == lines[1:-1]  # not those of the run
    for filters in ("--kind activated", "--node motion", "--frames 20:40"):
        assert cli(f"log {demo_run} --target 1 {filters}") == cli(f"log {demo_run} {filters}")


def test_log_explains_a_frame(cli, demo_run):
    on = next(e for e in open_run(demo_run).events if type(e) is Activated)
    before, after = (cli(f"log {demo_run} --why {on.frame + late}")[1] for late in (0, 1))
    assert re.search(r"^  motion     off  gave no evidence$", before, re.MULTILINE)
    assert re.search(r"^  from here  UD .* → motion on; ", before, re.MULTILINE)
    assert re.search(rf"^  motion     on .*\n +frame {on.frame}: UD .* → motion on;", after, re.MULTILINE)


def test_log_explains_a_score_by_the_coefficients_of_the_graph(cli, images, tmp_path):
    assert cli(f"run general --source {images} --init {BOX} --quiet --out", tmp_path / "run")[0] == 0
    said = cli(f"log {tmp_path / 'run'} --why 2")[1]
    assert re.search(r"^  score from bias \S+, log_ud_box \S+ × \S+ = \S+, texture .*; log odds ", said, re.M)
    assert "agreement" not in said
    (tmp_path / "run" / "graph.yaml").unlink()
    assert re.search(
        r"^  features   agreement .*; the coefficients are", cli(f"log {tmp_path / 'run'} --why 2")[1], re.M
    )


def test_log_says_when_nothing_is_left(cli, demo_run):
    assert cli(f"log {demo_run} --kind quarantined") == (0, "", "no events match\n")


def test_a_torn_last_line_is_dropped_with_a_notice(cli, demo_run, tmp_path):
    for name in ("journal.jsonl", "frames.npy.gz", "timings.jsonl", "graph.yaml", "truth.txt"):
        data = (demo_run / name).read_bytes()
        (tmp_path / name).write_bytes(data[:-7] if name.endswith(("jsonl", "gz")) else data)
    code, out, err = cli("log", tmp_path)
    assert code == 0 and "run ended" not in out
    assert re.fullmatch(r"\S+journal\.jsonl:\d+: the last line is torn \(\d+ bytes\) and was dropped\n", err)
    assert cli(f"log {tmp_path} --why 58")[0] == 0
    code, out, _ = cli("score", tmp_path)
    assert code == 0 and out.startswith("frames         59")


def test_score(cli, demo_run):
    code, out, _ = cli("score", demo_run)
    figures = json.loads(cli(f"score {demo_run} --json")[1])
    assert code == 0 and figures["frames"] == 60 and figures["auc"] > 0.6
    # This target is never absent.
    shown = {name for name in figures if not name.startswith(("long_", "statuses"))}
    one_a_line, table = out.split("\n\n")
    assert shown == {line.split()[0] for line in one_a_line.splitlines()}
    assert sum(int(count) for line in table.splitlines()[2:] for count in line.split()[1:]) == 60
    assert f"auc            {figures['auc']:.4g} " in out
    assert "share of frames whose centre is within 20 px" in out


def test_score_of_one_of_several_targets(cli, images, tmp_path):
    out, truth = tmp_path / "run", images / "groundtruth.txt"
    assert cli(f"run general --source {images} --init {BOX} --init 50,40,9,9 --quiet --out", out)[0] == 0
    code, _, err = cli(f"score {out} --truth {truth}")
    assert code == 2 and "several targets (1, 2); name one" in err
    near, far = (json.loads(cli(f"score {out} --truth {truth} --target {n} --json")[1]) for n in "12")
    assert near["mean_iou"] > 0.4 > far["mean_iou"]


# ------------------------------------------------------------------------------------ as a process


def command(*arguments, **settings):
    return subprocess.Popen([sys.executable, "-m", "bayesnet_track", *map(str, arguments)], **settings)


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error(demo_run):
    process = command("log", demo_run, "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.communicate()[1] == b""
    assert process.returncode == 0


@pytest.mark.slow
def test_nobody_reads_the_progress_and_tracking_goes_on(images, tmp_path):
    read, write = os.pipe()
    os.close(read)
    line = ("run", "general", "--source", images, "--init", BOX, "--out", tmp_path / "run")
    process = command(*line, stdout=subprocess.PIPE, stderr=write)
    os.close(write)
    assert b"8 frames" in process.communicate()[0]
    assert process.returncode == 0


def test_the_reader_of_help_goes_away():
    process = command("--help", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.communicate()[1] == b"" and process.returncode == 0


@pytest.mark.skipif(os.name != "posix", reason="closing streams is done by the shell")
@pytest.mark.parametrize(
    "closed", [pytest.param(one, marks=pytest.mark.slow) for one in (">&-", "2>&-", ">&- 2>&-")]
)
def test_a_service_may_have_no_streams(images, tmp_path, closed):
    line = f"run general --source {images} --init {BOX} --end 3 --out {tmp_path / 'run'}"
    shell = f"{shlex.quote(sys.executable)} -m bayesnet_track {line} {closed}"
    assert subprocess.run(["sh", "-c", shell], capture_output=True).returncode == 0
    assert len(column(tmp_path / "run", "frame")) == 3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are text")
def test_a_name_that_is_no_text(images, tmp_path):
    odd = os.fsencode(tmp_path) + b"/caf\xe9"
    shutil.copytree(os.fsencode(images), odd)
    line = [sys.executable, "-m", "bayesnet_track", "run", "general", "--init", BOX, "--source", odd]
    done = subprocess.run([*line, "--out", odd + b"-run"], capture_output=True)
    assert done.returncode == 0 and b"8 frames" in done.stdout
    shown = subprocess.run([*line[:3], "log", odd + b"-run"], capture_output=True)
    assert shown.returncode == 0 and b"caf" in shown.stdout


def test_a_terminal_without_the_letters(demo_run):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    process = command("log", demo_run, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate()
    assert (process.returncode, err) == (0, b"")
    assert b" frames ? motion off (largest KL " in out


def test_it_works_from_another_thread(images, tmp_path):
    """Signals cannot be handled there."""
    codes = []
    line = f"run general --source {images} --init {BOX} --out {tmp_path / 'run'} --quiet"
    thread = threading.Thread(target=lambda: codes.append(main(shlex.split(line))))
    thread.start()
    thread.join()
    assert codes == [0]


def _no_browser(address):
    raise webbrowser.Error("could not locate runnable browser")


@pytest.mark.parametrize("fault", [lambda _: False, _no_browser])
def test_a_page_that_no_browser_opens_is_said(demo_run, tmp_path, monkeypatch, capsys, fault):
    monkeypatch.setattr("webbrowser.open", fault)
    assert main(["report", str(demo_run), "--out", str(tmp_path / "page.html"), "--open"]) == 0
    said = capsys.readouterr().err
    assert "--open: no browser can be opened here" in said and (tmp_path / "page.html").as_uri() in said


def test_truth_of_another_length_is_asked_about(demo_run, tmp_path, capsys):
    few = tmp_path / "few.txt"
    few.write_text("1,2,3,4\n" * 7)
    main(["score", str(demo_run), "--truth", str(few)])
    assert f"{few} has 7 rows, the run 60 frames: is it of this video?" in capsys.readouterr().err
    few.write_text("57,21,31,45\n" * 80)
    for command in (["score"], ["report", "--out", str(tmp_path / "page.html")]):
        main([command[0], str(demo_run), "--truth", str(few), *command[1:]])
        said = capsys.readouterr().err
        assert f"{few} has 80 rows, the run 60 frames: as --end says. Not scored: rows 60 to 79" in said
    main(["score", str(demo_run)])
    assert "is it of this video" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("row", "options", "notice"),
    [
        ("270,190,40,40", "", "its numbers fit as centre x, centre y, w, h: say --truth-format centers"),
        ("250,170,290,210", "", "its numbers fit as left, top, right, bottom: say --truth-format corners"),
        ("125,85,20,20", "", "those of a video of another size: multiply all by 2"),
        ("5,60,31,45", "", "is it of this target?"),
        ("270,190,40,40", "--truth-format centers", ""),
        ("250,170,40,40", "", ""),
    ],
)
def test_truth_of_another_form_is_asked_about_by_the_first_box_of_the_run(
    demo_run, tmp_path, capsys, row, options, notice
):
    rows = tmp_path / "rows.txt"
    rows.write_text(f"{row}\n" * 60)
    main(["score", str(demo_run), "--truth", str(rows), *options.split()])
    error = capsys.readouterr().err
    assert notice in error and bool(notice) == ("in frame 0, the first of the run" in error)


def test_truth_of_the_whole_video_suits_a_run_of_its_beginning(images, tmp_path, capsys):
    line = f"run two_squares --source {images} --init {BOX} --end 4 --quiet --out {tmp_path / 'run'}"
    assert main(shlex.split(line)) == 0
    truth = tmp_path / "whole.txt"
    truth.write_text("1,2,3,4\n" * 7)
    main(["score", str(tmp_path / "run"), "--truth", str(truth)])
    assert "is it of this video" not in capsys.readouterr().err


def test_what_if_a_net_did_not_adapt_is_refused_where_it_never_does(cli, images, tmp_path):
    cli(f"run general --source {images} --init {BOX} --end 2 --quiet --out", tmp_path / "run")
    code, _, err = cli(f"what-if {tmp_path / 'run'} --no-adaptation --out", tmp_path / "other")
    assert code == 2
    assert "has `adapt`, `active` or `self_check`: all its agents are always on" in err

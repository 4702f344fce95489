"""Starts that fit two readings are refused; what is doubtful of one is said, at every entrance of a box."""

import warnings

import av
import numpy as np
import pytest

from bayesnet_track import Start, Tracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError, say_blank
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.entrances.notices import InputNotice

TEXTURE = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)


def write(folder, frames):
    """A video without loss."""
    path = folder / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width, stream.pix_fmt = 60, 80, "bgr0"
        for frame in frames:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="bgr24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


@pytest.fixture
def video(tmp_path):
    return write(tmp_path, [TEXTURE] * 3)


def started(graph, box, frame=TEXTURE):
    """The texts of what is said when a tracker starts."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Tracker(graph).init(frame, box)
    assert all(one.filename == __file__ for one in caught if one.category is InputNotice)
    return [str(one.message) for one in caught if one.category is InputNotice]


BOTH = "classes orange, gray, and the box names none; write orange:10,10,20,20 or gray:10,10,20,20"


@pytest.mark.parametrize("command", [["run"], ["simulate"]])
@pytest.mark.parametrize("how", ["--init", "--init-from"])
def test_a_box_without_a_class_is_refused_where_there_are_two(video, tmp_path, capsys, command, how):
    (tmp_path / "truth.txt").write_text("10,10,20,20\n")
    given = "10,10,20,20" if how == "--init" else str(tmp_path / "truth.txt")
    out = ["--out", str(tmp_path / "run")] if command == ["run"] else []
    assert main([*command, "orange_and_gray", "--source", str(video), how, given, *out]) == 2
    assert BOTH in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_python_refuses_a_box_without_a_class_too(video):
    for box in ((10, 10, 20, 20), [Start((10, 10, 20, 20))]):
        with pytest.raises(StartError, match=BOTH):
            track("orange_and_gray", str(video), box)
    with pytest.raises(StartError, match=BOTH):
        Tracker("orange_and_gray").init(TEXTURE, (10, 10, 20, 20))
    tracker = Tracker("orange_and_gray")
    tracker.init(TEXTURE, Start((10, 10, 20, 20), "gray"))
    assert tracker.detections().data["class_name"].tolist() == ["gray"]


@pytest.mark.slow
def test_a_batch_takes_the_class_of_a_box(tmp_path, video):
    command = ["batch", "orange_and_gray", "--source", str(video), "--out", str(tmp_path / "runs"), "-q"]
    assert main([*command, "--init", "gray:10,10,20,20", "--jobs", "1"]) == 0
    assert '"gray"' in (tmp_path / "runs" / "a" / "run.json").read_text()


@pytest.mark.parametrize(
    ("box", "said"),
    [
        ((70, 10, 40, 20), "(left, top, width, height): 75 % of it lies outside of the 80x60 frame"),
        ((-30, 10, 40, 20), "75 % of it lies outside"),
        ((50, 20, 70, 50), "if its numbers are left, top, right, bottom, write 50,20,20,30"),
        ((8, 12, 75, 50), "7.8 % of it lies outside"),
        ((20, 10, 70, 50), "if its numbers are left, top, right, bottom, write 20,10,50,40"),
    ],
)
def test_a_box_mostly_outside_is_said(video, tmp_path, capsys, box, said):
    notices = started("two_squares", box)
    assert len(notices) == 1 and said in notices[0]
    text = ",".join(map(str, box))
    run = ["run", "two_squares", "--source", str(video), f"--init={text}", "--out", str(tmp_path / "run")]
    assert main([*run, "-q"]) == 0
    assert capsys.readouterr().err.count(said) == 1


@pytest.mark.parametrize("box", [(10, 10, 20, 20), (60, 40, 25, 25), (-10, -5, 100, 70), (0, 0, 80, 60)])
def test_nothing_is_said_of_a_box_that_is_mostly_inside(box):
    assert started("two_squares", box) == []


@pytest.mark.parametrize(("value", "said"), [(0, "are 0 everywhere"), (128, "are 128 everywhere")])
def test_a_first_frame_that_shows_nothing_is_said(tmp_path, capsys, value, said):
    blank = np.full_like(TEXTURE, value)
    assert any(said in text for text in started("general", (10, 10, 20, 20), blank))
    path = write(tmp_path, [blank, TEXTURE, TEXTURE])
    run = ["run", "general", "--source", str(path), "--init", "10,10,20,20", "-q"]
    assert main([*run, "--out", str(tmp_path / "run")]) in (0, 2)
    err = capsys.readouterr().err
    assert f"frame 0, in which the target starts, shows nothing: its values {said}" in err
    assert main([*run, "--start", "1", "--out", str(tmp_path / "later")]) == 0
    assert "shows nothing" not in capsys.readouterr().err


def test_a_frame_with_noise_alone_is_blank_and_one_of_one_colour_with_a_target_is_not():
    def blank(image):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            say_blank(Frame(3, 3.0, image, True), [Start((1, 1, 9, 9))])
        return len(caught) == 1

    noise = np.random.default_rng(0).integers(0, 3, TEXTURE.shape, dtype=np.uint8)
    dim = noise.copy()
    dim[10:20, 10:20] = 9
    assert blank(noise) and not blank(dim) and not blank(TEXTURE)


def test_a_graph_that_finds_its_targets_may_begin_in_the_dark(recwarn):
    say_blank(Frame(0, 0.0, np.zeros_like(TEXTURE), True), [])
    assert not recwarn.list


@pytest.mark.parametrize(
    ("noise", "is_said"), [("{x: 9}", True), ("{x: 9, y: 0}", False), ("{x: 9, y: 9}", False)]
)
def test_an_axis_without_noise_is_said(tmp_path, capsys, noise, is_said):
    graph = tmp_path / "g.yaml"
    graph.write_text(
        f"""
bayesnet: 1
name: walk
targets:
  dot:
    nodes:
      dot: {{fuse: product, belief: {{particles: {{size: 9}}}}, motion: {{random_walk: {{sd_px: {noise}}}}}}}
      a: {{parent: dot, agent: color_histogram}}
""",
        encoding="utf-8",
    )
    assert main(["validate", str(graph)]) == 0
    said = (
        "random_walk has no noise of y, which stays as it is in the first frame; give it an sd, or write y: 0"
    )
    assert (said in capsys.readouterr().out) is is_said
    assert any(said in text for text in started(str(graph), (10, 10, 20, 20))) is is_said

"""The command `fit`: a graph calibrated on short videos, and what it says when something is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.main import main

GRAPH = """# my graph
bayesnet: 1
name: mine
targets:
  target:
    nodes:
      target:
        belief: {particles: {size: 100}}
        motion: {random_walk: {sd_box: {x: 0.2, y: 0.2}}}  # moves
      # an agent
      gray: {parent: target, agent: intensity}
"""


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two sequences of 16 frames: a patterned square that moves, then jumps away."""
    rng = np.random.default_rng(5)
    pattern = rng.integers(120, 255, (20, 20, 3)).astype(np.uint8)
    for name in ("one", "two"):
        folder = tmp_path / "data" / name
        (folder / "img").mkdir(parents=True)
        lines = []
        for k in range(16):
            x, y = (20 + 3 * k + k % 2, 30 + k % 3) if k < 10 else (110 + k % 2, 70 + k % 3)
            picture = np.full((100, 140, 3), 60, np.uint8)
            picture[y : y + 20, x : x + 20] = pattern
            cv2.imwrite(str(folder / "img" / f"{k:04d}.png"), picture)
            lines.append(f"{x},{y},20,20\n")
        (folder / "groundtruth.txt").write_text("".join(lines))
    (tmp_path / "g.yaml").write_text(GRAPH)
    return tmp_path


@pytest.mark.slow
def test_a_graph_is_calibrated_and_keeps_its_comments(data, capsys):
    out = data / "fitted.yaml"
    what = "score,localization_error,lost,temperature"
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    assert main([*arguments, "--what", what, "--out", str(out)]) == 0
    text = out.read_text()
    assert [line for line in GRAPH.splitlines() if line not in text.splitlines()] == [
        "      gray: {parent: target, agent: intensity}"
    ]
    assert "# fit: probability of IoU > 0.5; 30 frames of 2 videos" in text
    root = load_graph(out).targets["target"].inference("target")
    assert root.score is not None and root.localization_error is not None and root.lost is not None
    assert root.lost.uncertain_below is not None and root.lost.score_below < root.lost.uncertain_below
    # Again, from what was written: the same keys once more, not twice.
    assert main(["fit", str(out), *arguments[2:], "--out", str(out), "--overwrite"]) == 0
    assert out.read_text().count("# fit: probability") == 1
    assert not (data / "fitted.yaml.part").exists()


def test_which_of_several_classes_is_fitted_is_said(data, capsys):
    _, nodes = GRAPH.split("targets:\n")
    second = nodes.replace("target", "person")
    (data / "g.yaml").write_text(GRAPH + second)
    assert main(["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--what", "score"]) == 0
    said = capsys.readouterr()
    assert "has the classes target, person: target, the first one, is fitted, and person not" in said.err
    first, other = said.out.split("\n  person:\n")
    assert "# fit: " in first and "# fit: " not in other


def test_what_is_not_estimated_of_lost_is_kept(data, capsys):
    """`relocalize: sudden` needs `found_fit`; without it the graph that was written would be refused."""
    score = "score: {logistic: {bias: 1, log_fit: 1}}"
    levels = "score_below: 0.2, uncertain_below: 0.6"
    rules = f"{score}\n        lost: {{{levels}, frames: 4, found_fit: 0.3, scene_cut: 0.4}}"
    motion = "relocalize: {share: 0.1, sudden: {below_fit: 0.2}}"
    text = GRAPH.replace(
        "motion: {random_walk: {sd_box: {x: 0.2, y: 0.2}}}  # moves",
        f"motion: {{random_walk: {{sd_box: {{x: 0.2, y: 0.2}}, {motion}}}}}\n        {rules}",
    )
    (data / "g.yaml").write_text(text)
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    assert main([*arguments, "--out", str(data / "fitted.yaml")]) == 0
    lost = load_graph(data / "fitted.yaml").targets["target"].inference("target").lost
    assert (lost.frames, lost.found_fit, lost.scene_cut) == (4, 0.3, 0.4)
    assert lost.score_below != 0.2


def test_coefficients_of_verifiers_are_fitted_and_their_settings_kept(data, capsys):
    verifiers = "{texture: {agent: texture, every: 2}, first: {agent: intensity, learn_rate: 0}}"
    score = f"score: {{logistic: {{bias: 1, verifiers: {verifiers}}}}}"
    (data / "g.yaml").write_text(GRAPH.replace("# moves\n", f"# moves\n        {score}\n"))
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    out = data / "fitted.yaml"
    assert main([*arguments, "--features", "log_fit,first", "--what", "score", "--out", str(out)]) == 0
    root = load_graph(out).targets["target"].inference("target")
    found = root.score.settings.verifiers
    assert found["first"].coefficient > 0.01 and found["texture"].coefficient == 0.0
    assert (found["texture"].every, found["first"].learn_rate) == (2, 0)
    assert main([*arguments, "--features", "log_fit,second"]) == 2
    assert "no 'second'; there are" in (said := capsys.readouterr().err) and "texture, first" in said


def test_levels_are_fitted_to_the_score_that_the_graph_has(data, capsys):
    score = "score: {logistic: {bias: 1, log_fit: 1}}"
    rules = f"{score}\n        lost: {{score_below: 0.2, uncertain_below: 0.6, found_fit: 0.3}}"
    (data / "g.yaml").write_text(GRAPH.replace("# moves\n", f"# moves\n        {rules}\n"))
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    out = data / "fitted.yaml"
    assert main([*arguments, "--what", "lost", "--out", str(out)]) == 0
    root = load_graph(out).targets["target"].inference("target")
    assert (
        root.score.settings
        == load_graph(data / "g.yaml").targets["target"].inference("target").score.settings
    )
    assert root.lost.score_below != 0.2 and root.lost.uncertain_below >= 0.51
    assert "2 % of the frames on target score below" in out.read_text()


@pytest.mark.slow
def test_the_features_of_the_score_are_those_that_it_has(data, capsys):
    """To fit them again must not leave the verifiers out."""
    verifiers = "{first: {agent: intensity, learn_rate: 0, coefficient: 1}, rest: {agent: texture}}"
    score = f"score: {{logistic: {{bias: 1, log_fit: 0.5, verifiers: {verifiers}}}}}"
    (data / "g.yaml").write_text(GRAPH.replace("# moves\n", f"# moves\n        {score}\n"))
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    named, unnamed = data / "named.yaml", data / "unnamed.yaml"
    assert main([*arguments, "--what", "score", "--out", str(unnamed)]) == 0
    assert main([*arguments, "--what", "score", "--features", "log_fit,first", "--out", str(named)]) == 0
    assert unnamed.read_text() == named.read_text()


def test_coefficients_of_confidence_are_fitted(data, capsys):
    score = "score: {logistic: {bias: 1, confidence: {net: 0.5}}}"
    net = "net: {parent: target, agent: siamese_box}"
    text = GRAPH.replace("# moves\n", f"# moves\n        fuse: product\n        {score}\n")
    (data / "g.yaml").write_text(text.replace("      # an agent\n", f"      {net}\n"))
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    out, names = data / "fitted.yaml", "log_fit,confidence.net"
    assert main([*arguments, "--features", names, "--what", "score", "--out", str(out)]) == 0
    root = load_graph(out).targets["target"].inference("target")
    assert list(root.score.settings.confidence) == ["net"]
    assert root.score.settings.confidence["net"] >= 0.0
    assert main([*arguments, "--features", "confidence.nett"]) == 2
    assert "agreement, log_size, border, confidence.net\n" in capsys.readouterr().err


POOLED = GRAPH.replace("# moves\n", "# moves\n        fuse: {pool: learned}  # dependent\n").replace(
    "agent: intensity}", "agent: intensity}\n      colors: {parent: target, agent: foreground_color}"
)


def test_the_correlation_of_a_learned_pool_is_written(data, capsys):
    """The square stands still here, so that 20 frames are on target."""
    (data / "g.yaml").write_text(POOLED)
    folder, out = data / "still", data / "fitted.yaml"
    (folder / "one" / "img").mkdir(parents=True)
    pattern = np.random.default_rng(5).integers(60, 255, (20, 20, 3)).astype(np.uint8)
    lines = []
    for k in range(24):
        x = 40 + 2 * (k % 3)
        picture = np.random.default_rng(k).integers(50, 70, (80, 100, 3)).astype(np.uint8)
        picture[30:50, x : x + 20] = pattern
        cv2.imwrite(str(folder / "one" / "img" / f"{k:04d}.png"), picture)
        lines.append(f"{x},30,20,20\n")
    (folder / "one" / "groundtruth.txt").write_text("".join(lines))
    assert main(["fit", str(data / "g.yaml"), "--folder", str(folder), "--fusion", "--out", str(out)]) == 0
    said = capsys.readouterr().err.splitlines()[-1]
    node = load_graph(out).targets["target"].inference("target")
    assert node.correlation is not None and 0.0 <= node.correlation <= 1.0
    assert said.startswith(f"target: errors correlated by {node.correlation:g} (")
    assert said.endswith(f"each of 2 children counts {1 / (1 + node.correlation):.2f}")
    assert "# fit: errors at true boxes, 23 frames of 1 video" in out.read_text()
    assert "fuse: {pool: learned}  # dependent" in out.read_text()


ADAPTIVE = GRAPH.replace(
    "  # moves\n",
    """
        fuse: product
        adapt:
          activate: {above: {ud_px2: 40}}  # on
          deactivate: {below: {ud_px2: 20}, frames: 1}
""",
).replace("agent: intensity}", "agent: intensity}\n      flow: {parent: target, agent: motion}  # flows")


@pytest.mark.slow
def test_sds_and_policy_are_written_before_the_score_is_fitted(data, capsys):
    (data / "g.yaml").write_text(ADAPTIVE)
    out = data / "fitted.yaml"
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    assert main([*arguments, "--what", "sds,policy,score", "--out", str(out)]) == 0
    text, said = out.read_text(), capsys.readouterr().err
    assert "# on" in text and "# flows" in text and "# my graph" in text
    assert "# fit: sd_x_px, sd_y_px: residuals at true boxes, 26 in 2 videos" in text
    assert "# fit: probability of IoU > 0.5; 30 frames of 2 videos" in text
    plate = load_graph(out).targets["target"]
    sds = plate.agent("flow").agent.parameters
    assert 1 < sds["sd_x_px"] < 4 and 1 < sds["sd_y_px"] < 4  # its flow changes by 2 px in x, by 1 to 3 in y
    adapt = plate.inference("target").adapt
    assert adapt.deactivate.below.settings < adapt.activate.above.settings
    assert "policy: on above" in said and "chosen from" in said
    # Again, from what was written: the same comments once more, not twice.
    assert main(["fit", str(out), *arguments[2:], "--what", "sds", "--out", str(out), "--overwrite"]) == 0
    assert out.read_text().count("# fit: sd_x_px") == 1


@pytest.mark.parametrize("what", ["sds", "policy"])
def test_one_video_is_too_few(data, capsys, what):
    (data / "g.yaml").write_text(ADAPTIVE)
    one = ("--source", "DATA/one/img", "--truth", "DATA/one/groundtruth.txt", "--what", what)
    assert wrong(data, *one) == 2
    assert f"{what}: one video; two or more are needed" in capsys.readouterr().err


def test_leaving_one_out_prints_a_row_a_video(data, capsys):
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    assert main([*arguments, "--leave-one-out"]) == 0
    rows = [line.split()[:2] for line in capsys.readouterr().out.splitlines()[:4]]
    assert rows == [["video", "frames"], ["one", "15"], ["two", "15"], ["all", "30"]]


SCORED = GRAPH.replace("  # moves\n", "  # moves\n        score: {logistic: {bias: 3, log_fit: 1.5}}\n")


def test_promises_are_written_into_the_graph_and_said(data, capsys):
    (data / "g.yaml").write_text(SCORED)
    out = data / "promised.yaml"
    arguments = ["fit", str(data / "g.yaml"), "--folder", str(data / "data"), "--seeds", "1"]
    promises = ["--guarantee", "0.4", "--alarm", "0.5", "--out", str(out)]
    assert main([*arguments, *promises]) == 0
    text, said = out.read_text(), capsys.readouterr().err
    root = load_graph(out).targets["target"].inference("target")
    assert root.guarantee is not None and (root.guarantee.share, root.guarantee.frames) == (0.4, 3)
    levels = root.guarantee.afterwards
    assert len(levels) == 20 and levels[0] <= levels[19] == root.guarantee.above
    assert "are called tracking, 100 % where a run is judged when it is over" in said
    assert root.alarm is not None and (root.alarm.share, root.alarm.videos) == (0.5, 2)
    assert "# fit: expected share called tracking with IoU <= 0.5 at most 40 %" in text
    assert "# moves" in text and "bias: 3, log_fit: 1.5" in text
    assert "a statement about the mean, not about each video" in said
    assert "With 2 videos the calibrated share may be at most 10 %" in said
    assert "is void if one of these was used to choose or fit" in said
    assert main([*arguments, *promises, "--overwrite", "--off-target", "0.1"]) == 0
    assert "# fit: expected share called tracking with IoU <= 0.1 at most 40 %" in out.read_text()
    assert "frames called tracking with IoU ≤ 0.1 is at most 40 %" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "least"), [("guarantee", 19), ("alarm", 20)])
def test_too_few_videos_for_a_promise(data, capsys, name, least):
    score = "score: {logistic: {bias: 1, log_fit: 0.5}}"
    (data / "g.yaml").write_text(GRAPH.replace("# moves\n", f"# moves\n        {score}\n"))
    assert wrong(data, "--folder", "DATA", f"--{name}", "0.05") == 2
    assert f"--{name} 0.05 needs {least} videos or more, and there are 2:" in capsys.readouterr().err


def wrong(data, *arguments):
    given = [str(one).replace("DATA", str(data / "data")) for one in arguments]
    return main(["fit", str(data / "g.yaml"), "--seeds", "1", *given])


CASES = [
    ((), "no video: give --source with --truth, or --folder"),
    (("--source", "DATA/one/img"), "1 --source and 0 --truth: every video needs its truth"),
    (("--folder", "DATA/one"), "DATA/one: no NAME/groundtruth.txt beside NAME/img"),
    (
        ("--source", "DATA/one/img", "--truth", "DATA/none.txt"),
        "--truth DATA/none.txt: No such file or directory; expected a text file with one box x,y,w,h "
        "per line",
    ),
    (
        ("--source", "DATA/one/img", "--truth", "DATA/short.txt"),
        "one: 16 frames, and 3 boxes of ground truth",
    ),
    (
        ("--source", "DATA/one/img", "--truth", "DATA/absent.txt"),
        "one: the truth has no box in the first frame",
    ),
    (
        ("--source", "DATA/one/img", "--truth", "DATA/wide.txt"),
        "start box 1,1,1e+308,1e+308: at most 10 times the 140x100 frame is allowed, 1400x1000 px",
    ),
    (
        ("--folder", "DATA", "--end", "6"),
        "every frame is on target (IoU above 0.5); fitting also needs some that are not",
    ),
    (
        ("--folder", "DATA", "--what", "score,sizes"),
        "--what: no 'sizes'; there are score, localization_error, lost, ud, temperature, sds, policy, fusion",
    ),
    (
        ("--folder", "DATA", "--what", "sds"),
        "sds: no agent of the target has any to estimate; color_blobs and motion have",
    ),
    (
        ("--folder", "DATA", "--what", "policy"),
        "policy: the root needs `adapt` with `activate: {above: ...}` and `deactivate: {below: ...}`, "
        "levels of UD in the same unit",
    ),
    (
        ("--folder", "DATA", "--fusion"),
        "fusion: no node with fuse: {pool: learned}, whose correlation is to be estimated",
    ),
    (
        ("--folder", "DATA", "--what", "policy,ud"),
        "--what: ud and policy both set the levels of `activate` and `deactivate`; choose one",
    ),
    (
        ("--folder", "DATA", "--what", "score,sds", "--leave-one-out"),
        "--leave-one-out judges score and regions; fit sds, fusion and policy to other videos first",
    ),
    (
        ("--folder", "DATA", "--guarantee", "0.05"),
        "target has no `score`, which --guarantee and --alarm need; fit one to other videos first, with "
        "--what score",
    ),
    (
        ("--folder", "DATA", "--off-target", "0.1"),
        "--off-target says which frames are wrong for --guarantee; give that, too",
    ),
    (
        ("--folder", "DATA", "--guarantee", "0.05", "--what", "score"),
        "--guarantee and --alarm calibrate a graph as it is; fit its score to other videos first, in a call "
        "of its own, with --what",
    ),
    (
        ("--folder", "DATA", "--what", "lost"),
        "--what: lost goes by the score, and the graph has none; add score to --what",
    ),
    (
        ("--folder", "DATA", "--what", "localization_error,lost"),
        "--what: localization_error and lost go by the score, and the graph has none; add score to --what",
    ),
    (("--what", "sds"), "no video: give --source with --truth, or --folder"),
    (
        ("--folder", "DATA", "--features", "luck"),
        "--features: no 'luck'; there are log_ud_box, evidence, log_fit, agreement, log_size, border",
    ),
    (
        ("--folder", "DATA", "--out", "DATA/one/groundtruth.txt"),
        "DATA/one/groundtruth.txt exists; --overwrite replaces it",
    ),
]


@pytest.mark.parametrize(("arguments", "said"), CASES)
def test_mistakes(data, capsys, arguments, said):
    (data / "data" / "wide.txt").write_text("1,1,1e308,1e308\n" * 16)
    (data / "data" / "short.txt").write_text("1,1,9,9\n" * 3)
    (data / "data" / "absent.txt").write_text("nan,nan,nan,nan\n" + "1,1,9,9\n" * 15)
    assert wrong(data, *arguments) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"bayesnet-track fit: {said}".replace("DATA", str(data / "data"))
    assert (data / "data" / "one" / "groundtruth.txt").read_text().startswith("20,30")

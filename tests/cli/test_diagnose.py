"""What `diagnose` finds in the lines of a run, and that what it says can be done."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli import findings
from bayesnet_track.cli.commands import diagnose
from bayesnet_track.cli.commands.diagnose import advise, find_all, names_of
from bayesnet_track.cli.findings import COLUMNS, FEW_FRAMES, REMEDIES, Finding, until_lost
from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import make_parser
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.journal.blocks import courses
from bayesnet_track.journal.events.cameras import CameraKnocked
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.metrics import FrameMetrics

FRAMES = 40


def course_of(lines):
    """The course of the only target of some lines."""
    (course,) = courses(lines, COLUMNS, None if lines else ["1"]).values()
    return course


def find(lines, switches=0):
    return findings.find(course_of(lines), switches)


@pytest.fixture
def lines():
    """A run in which nothing is wrong."""
    one = FrameMetrics(
        0, 0.0, "1", (30.0, 35.0, 40.0, 30.0), (30.0, 35.0, 40.0, 30.0), (1.0,) * 4, 50.0, {}, None,
        "tracking", 0.9, -2.0, 0.5, 250.0, 500, ("color", "filter"), {"color": 0.1, "filter": 0.2},
        {"color": 0.1, "filter": 2.0}, {}, {}, 0.03, (0.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0), (),
    )  # fmt: skip
    return [replace(one, frame=n, log_evidence=-2.0 - 0.01 * (n % 7)) for n in range(FRAMES)]


def test_a_run_in_which_nothing_is_wrong(lines):
    assert list(find(lines)) == []
    assert list(find([replace(line, status="lost") for line in lines[:FEW_FRAMES]])) == []


@pytest.mark.parametrize(
    ("changed", "frames", "remedy", "words"),
    [
        ({"status": "lost"}, range(30, 40), "gone", "lost in 10 of 39 frames, decided in frame 29"),
        ({"status": "lost"}, range(10, 14), None, "lost in 4 of 39 frames, decided in frame 9"),
        (
            {"status": "uncertain", "features": {"most": 0.5, "log_fit": -0.1}},
            range(9, 29),
            "alike",
            "uncertain in 20 of 39 frames, decided in frame 8, in 20 of them because of a look-alike",
        ),
        (
            {"status": "uncertain", "features": {"most": 0.4, "log_fit": -4.0}},
            range(9, 29),
            None,
            "uncertain in 20 of 39 frames, decided in frame 8; the best box has 0.018 of the likelihood",
        ),
        (
            {"status": "uncertain", "features": {"most": 1.0, "log_fit": -0.5, "texture": -3.0, "old": -1.0}},
            range(9, 29),
            None,
            "0.61 of the likelihood of a perfect match (median); by the verifier texture it has 0.05",
        ),
        (
            {"status": "uncertain", "features": {"most": 1.0, "old": -1.0, "confidence.net": 1.4}},
            range(9, 29),
            None,
            "frame 8; by the verifier old it has 0.37; net is sure of it to 80% (median)",
        ),
        ({"ess": 2.0}, range(40), "sharp", "the effective number of hypotheses is 2.0 (median; below 3)"),
        ({"log_evidence": -9.0}, range(20, 23), "bursts", "in 3 of 39 frames the evidence is far below"),
        ({"kl": {"color": 0.1, "filter": 5.0}}, range(40), "sharp", "filter contradicts the belief: KL 5.0"),
        ({"learn_rate": 0.0}, range(40), "stale", "references learned in 0 of 39 frames only"),
    ],
)
def test_what_stands_out(lines, changed, frames, remedy, words):
    (found,) = find([replace(line, **changed) if line.frame in frames else line for line in lines])
    assert found.remedy == remedy and words in found.what
    assert found.agent == ("filter" if remedy == "sharp" else None)


@pytest.mark.parametrize(
    ("usual", "rest", "remedy", "words"),
    [
        (0.5, 0.01, "narrow", "outside of the predicted 95 % in 10 of 39 frames, first in frame 30"),
        (0.9, 0.9, "wide", "filter measures closer to the prediction than predicted: p-value 0.90 (median"),
    ],
)
def test_measurements_that_were_not_predicted_stand_out(lines, usual, rest, remedy, words):
    p = [usual if line.frame < 30 else rest for line in lines]
    (found,) = find([replace(line, p_values={"filter": one}) for line, one in zip(lines, p, strict=True)])
    assert found.remedy == remedy and found.agent == "filter" and words in found.what
    assert not list(find([replace(line, p_values={"filter": line.frame / 40}) for line in lines]))


@pytest.mark.parametrize("change", [{"ess": 4.0}, {"surprise": 5.0}])
def test_what_good_runs_have_as_often_as_bad_ones_is_not_reported(lines, change):
    assert list(find([replace(line, **change) for line in lines])) == []
    few = [replace(line, status="uncertain") if line.frame < 4 else line for line in lines]
    assert list(find(few)) == []


def test_agents_that_are_only_sampled_do_not_flicker_and_change_no_evidence(lines):
    sampled = {"active": ("color",), "log_evidence": -9.0}
    assert list(find([replace(line, **sampled) if line.frame % 3 else line for line in lines], 1)) == []
    (found,) = find(lines, 20)
    assert found.remedy == "flicker" and found.what.startswith("agents are switched 20 times in 39 frames")


@pytest.mark.parametrize("name", REMEDIES)
def test_every_key_of_the_table_is_one_of_the_language(name):
    """Of `general`, or of a graph whose agents are switched by rules."""
    of = "two_squares" if ".adapt." in REMEDIES[name].key else "general"
    text = load_graph(of).text
    plate, agent = ("square", "color") if of == "two_squares" else ("target", "filter")
    setting = REMEDIES[name].setting(names_of(text, plate, agent))
    assert change_graph(text, [setting]).text != text, f"{setting}: that is the value that it has already"


@dataclass(frozen=True)
class OpenRun:
    """What `diagnose` reads of a run directory."""

    graph_text: str
    kinds: dict[str, str]
    metrics: list
    events: tuple = ()

    @property
    def targets(self):
        return tuple(self.kinds)


def test_an_agent_that_failed_stands_out_however_short_the_run(lines):
    failed = [Quarantined(n, "1", "filter", "raised ValueError: no", n + 10) for n in (1, 12)]
    run = OpenRun(load_graph("general").text, {"1": "target"}, lines[:3], tuple(failed))
    (found,) = find_all(run)
    assert found.what == "filter failed 2 times, first in frame 1: raised ValueError: no"
    assert not advise(run, found)["seed"]


def test_a_target_that_detections_started_may_end_as_lost(lines):
    left = [replace(line, status="lost") if line.frame >= 30 else line for line in lines]
    assert until_lost(course_of(left)).frame.tolist() == list(range(30)) and not until_lost(course_of([]))
    born = OpenRun(load_graph("kalman_detections").text, {"1": "target"}, left)
    assert not list(find_all(born)) and list(find_all(replace(born, graph_text=load_graph("general").text)))


def test_what_many_targets_have_in_common_is_printed_once(lines, monkeypatch, capsys):
    ids = [str(n) for n in range(1, 13)]
    gap = [replace(line, status="lost") if line.frame in (5, 6) else line for line in lines]
    every = [replace(line, target=name) for name in ids for line in gap]
    run = OpenRun(load_graph("kalman_detections").text, dict.fromkeys(ids, "target"), every)
    monkeypatch.setattr("bayesnet_track.runtime.recording.run_reader.open_run", lambda *_: run)
    assert main(["diagnose", "R"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[:3] == [
        "target 1: lost in 2 of 39 frames, decided in frame 4",
        "  look  bayesnet-track log R --why 4",
        "  also  11 other targets: 2, 3, 4, 5, 6, 7, 8, 9, ...",
    ]
    assert len(said) == 4


def test_cameras_that_are_found_off_again_and_again_may_be_exchanged(monkeypatch, capsys):
    asked = []
    for cameras in (("west", "west", "west", "east"), ("west", "east", "north", "west", "east")):
        knocks = [
            CameraKnocked(n, camera, 9.0, 0.0, 1.0, n, 3, 3, 50.0) for n, camera in enumerate(cameras, 9)
        ]
        run = OpenRun(load_graph("general").text, {}, [], tuple(knocks))
        monkeypatch.setattr("bayesnet_track.runtime.recording.run_reader.open_run", lambda *_, run=run: run)
        assert main(["diagnose", "R"]) == 0
        asked += [line for line in capsys.readouterr().out.splitlines() if line.endswith("exchanged?")]
    (question,) = asked
    assert question.startswith("cameras west, east are found off again and again: are their files")


def test_a_key_is_refused_with_the_reason_and_not_because_of_a_cue_of_the_user(lines):
    gone = Finding("1", "lost", "gone", measure="lost")
    general = load_graph("general").text
    own = OpenRun(general.replace("correlation_filter", "my_own_cue"), {"1": "target"}, lines)
    assert advise(own, gone)["try"] == advise(replace(own, graph_text=general), gone)["try"] is not None
    kalman = replace(own, graph_text=load_graph("kalman_detections").text)
    reason = "relocalize beside gaussian, and no agent of the whole says how sure it is anywhere"
    assert advise(kalman, gone)["refused"] == reason
    said = "\n".join(diagnose._lines("R", advise(kalman, gone)))
    assert f".relocalize.share, but not in this graph: {reason}" in said


def test_names_of_a_graph():
    names = names_of(load_graph("general").text, "target", "filter")
    assert (names["ROOT"], names["MOTION"], names["CUE"]) == ("target", "random_walk", "correlation_filter")


@pytest.mark.parametrize("name", REMEDIES)
def test_every_row_names_a_command_that_shows_it(name):
    words = REMEDIES[name].command.replace("--why N", "--why 3").split()
    assert make_parser().parse_args(words).command == words[0]


def test_the_page_has_the_table():
    page = Path(__file__).parents[2] / "docs" / "which_key.md"
    rows = [
        f"| {one.symptom} | `{one.command}` | `{one.key}` | `{one.value}` | {one.why} |"
        for one in REMEDIES.values()
    ]
    assert "\n".join(rows) in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_command_reads_a_run_and_what_it_says_is_a_command(tmp_path, capsys):
    out = str(tmp_path / "run")
    assert (
        main(
            [
                "demo",
                "gray_square",
                "--end",
                "30",
                "-q",
                "-o",
                out,
                "--set",
                "square.belief.particles.size=30",
            ]
        )
        == 0
    )
    assert main(["diagnose", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["run"] == out and all("try" in one and "key" in one for one in found["findings"])
    assert main(["diagnose", out]) == 0
    said = capsys.readouterr().out
    assert "bayesnet-track " in said
    assert main(["diagnose", out, "--target", "7"]) == 2
    assert main(["diagnose", str(tmp_path)]) == 4


@pytest.mark.slow
def test_a_camera_that_was_knocked_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "room_knocked", "--end", "104", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["diagnose", "runs/room_knocked"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("camera west is ")
    assert "bayesnet-track log runs/room_knocked --why 100" in text
    assert main(["diagnose", "runs/room_knocked", "--json"]) == 0
    (camera,) = json.loads(capsys.readouterr().out)["cameras"]
    assert camera["camera"] == "west"

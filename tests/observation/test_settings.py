"""A message names settings as its reader gives them: options on the command line, parameters in Python."""

import argparse
import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import COMMANDS, make_parser
from bayesnet_track.evaluate.truth import read_truth
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.observation.settings import PARAMETERS, by_command_line, setting
from bayesnet_track.runtime.checkpoints.resume import resume
from bayesnet_track.runtime.executors import make_executor, parse_places
from bayesnet_track.runtime.recording.exports import write_arviz
from bayesnet_track.runtime.smoothing import smooth
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source
from bayesnet_track.sources.stereo_source import open_stereo_source
from bayesnet_track.vision.calibration import calibrate_pair


def test_a_black_first_frame_is_said_in_the_words_of_the_reader(tmp_path, capsys):
    black = np.zeros((48, 64, 3), np.uint8)
    with pytest.warns(InputNotice, match=r"start in another one \(start=N\)"):
        Tracker("general").init(black, (20, 12, 16, 16))
    cv2.imwrite(str(tmp_path / "0.png"), black)
    main(
        [
            "run",
            "general",
            "--source",
            str(tmp_path),
            "--init",
            "20,12,16,16",
            "--out",
            str(tmp_path / "r"),
            "-q",
        ]
    )
    assert "start in another one (--start N)" in capsys.readouterr().err
    with pytest.warns(InputNotice, match=r"start in another one \(start=N\)"):
        Tracker("general").init(black, (20, 12, 16, 16))


def test_a_negative_value_is_joined_to_its_option():
    with by_command_line():
        assert setting("--range", "-5,5") == "--range=-5,5" and setting("--end") == "--end"
    assert setting("--range", "-5,5", "(-5, 5)") == "value_range=(-5, 5)"


ROOT = Path(__file__).parents[2]
WRITERS = ("setting", "to_caller")
"""Functions that word a message by its reader."""
PAGES_ALONE = {
    "sources/entrances/table.py": "rows of docs/entrances.md",
    "view/compare_page.py": "a style sheet",
}
"""Modules whose texts are no messages, and what they are."""
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def option_strings(command=None) -> set[str]:
    """Options of a command, or of all."""
    (commands,) = (one for one in make_parser()._actions if isinstance(one, argparse._SubParsersAction))
    parsers = commands.choices.values() if command is None else [commands.choices[command]]
    return {option for parser in parsers for option in _options_below(parser)}


def _options_below(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Options of a command and of its own commands."""
    yield from parser._option_string_actions
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _options_below(inner)


def without_commands(text: str) -> str:
    """A text without the commands that stand in it in full: whoever calls Python can type those, too."""
    return re.sub(rf"`(bayesnet-track )?({'|'.join(COMMANDS)}) [^`]*`", "", text)


def options_in_messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, option) of texts that name one outside of `WRITERS`, docstrings and descriptions of keys."""
    spared = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            spared.add(node.value)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in WRITERS:
            spared.update(ast.walk(node))
        elif isinstance(node, ast.keyword) and node.arg == "description":
            spared.update(ast.walk(node.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in spared:
            for option in OPTION.findall(without_commands(node.value)):
                yield node.lineno, option


@pytest.mark.slow
def test_no_message_names_an_option_to_a_caller_of_python():
    package = ROOT / "bayesnet_track"
    modules = [*package.rglob("*.py"), *(ROOT / "cues").rglob("*.py")]
    found, walked = [], 0
    for path in modules:
        name = path.relative_to(package if path.is_relative_to(package) else ROOT).as_posix()
        if name.startswith("cli/") or name in (*PAGES_ALONE, "observation/settings.py"):
            continue
        walked += 1
        if OPTION.search(text := path.read_text()):
            found += [f"{name}:{at}: {option}" for at, option in options_in_messages(ast.parse(text))]
    assert walked > 200
    assert not found, f"say these by observation.settings.setting or to_caller: {found}"


def test_the_walk_finds_options_in_texts_of_every_kind():
    source = '''
def f(option):
    """Docstrings may name --this."""
    g(setting("--not-this", "1"), description="nor --this")
    h = "see `score --truth`" + f"{option} or `--one`"
    raise ValueError("give --two" if option else ("or", "--three=3"))
'''
    assert [option for _, option in options_in_messages(ast.parse(source))] == ["--one", "--two", "--three"]


def test_every_setting_is_an_option_and_a_parameter():
    takers = (
        calibrate_pair, change_graph, make_executor, open_source, open_stereo_source, read_truth, resume,
        smooth, track, write_arviz,
    )  # fmt: skip
    parameters = {name for taker in takers for name in inspect.signature(taker).parameters}
    assert PARAMETERS.keys() <= option_strings()
    assert {parameter.partition("=")[0] for parameter in PARAMETERS.values()} <= parameters


def images(folder: Path) -> str:
    """The path of a folder with one gray image in it."""
    path = folder / "images"
    path.mkdir(parents=True)
    cv2.imwrite(str(path / "0.png"), np.arange(48 * 64, dtype=np.uint8).reshape(48, 64))
    return str(path)


def over_a_run(folder: Path) -> None:
    for name in "ab":
        list(track("general", images(folder / name), (1, 1, 9, 9), out=folder / "run"))


def late_ball(folder):
    """A graph whose sensor is late, so that its beliefs cannot be kept."""
    (folder / "late.csv").write_text("frame,x\n0,20\n1,20\n", encoding="utf-8")
    graph = folder / "late.yaml"
    sensor = f"{{readings: {{file: {folder / 'late.csv'}, sd: {{x: 2}}, delay: 1}}}}"
    graph.write_text(
        "bayesnet: 1\nname: late\ntargets:\n  ball:\n    nodes:\n"
        "      ball: {belief: {gaussian: {filter: extended}}, motion: {constant_velocity: {}}}\n"
        f"      late: {{parent: ball, agent: {sensor}}}\n",
        encoding="utf-8",
    )
    return str(graph)


REFUSED_IN_PYTHON = {
    "network": (
        lambda _: next(track("general", "http://a.b/c.mp4", (1, 1, 5, 5))),
        "allow_network=True",
    ),
    "run is there": (over_a_run, "overwrite=True"),
    "no detections": (lambda at: next(track("kalman_detections", images(at))), "detections=FILE"),
    "no depth": (
        lambda at: next(track("person_stereo", images(at), (1, 1, 9, 9))),
        r"a pair \(right=SOURCE or side_by_side=True, with calibration=FILE\).*depth=FOLDER",
    ),
    "two second eyes": (
        lambda at: open_stereo_source(images(at), right="r", depth="d"),
        "right=SOURCE, side_by_side=True and depth=FOLDER",
    ),
    "no calibration": (lambda at: open_stereo_source(images(at), right="r"), "calibration=FILE"),
    "changed": (
        lambda _: change_graph(load_graph("general").text, ["target.belief=1"]),
        "^changes",
    ),
    "place": (lambda _: parse_places(["flow=moon"]), "^place 'flow=moon'"),
    "beliefs": (
        lambda at: next(track(late_ball(at), images(at), (1, 1, 9, 9), out=at / "r", keep_beliefs=True)),
        "^keep_beliefs=True.*no keep_beliefs=True",
    ),
}


@pytest.mark.parametrize("entrance", REFUSED_IN_PYTHON)
def test_errors_in_python_name_parameters(entrance, tmp_path):
    call, words = REFUSED_IN_PYTHON[entrance]
    with pytest.raises(Exception, match=words) as raised:
        call(tmp_path)
    assert not OPTION.search(without_commands(str(raised.value)))

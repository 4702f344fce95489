"""Completion as a shell does it: the script is sourced, and what it offers for a line is read back."""

import contextlib
import io
import shlex
import shutil
import subprocess

import pytest

from bayesnet_track.cli.commands.graphs import actions, kind_of
from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import make_parser
from bayesnet_track.graphs import graph_names
from bayesnet_track.sources.scenes import scene_names

BASH = shutil.which("bash")


@pytest.fixture(scope="module")
def offered(tmp_path_factory):
    """Words of a line, the last one begun -> what bash offers, in a folder with two files and a folder."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "mine.yaml").touch()
    (folder / "mine.txt").touch()
    (folder / "runs").mkdir()

    def offer(script, line):
        words = shlex.split(line) + ([""] if line.endswith(" ") else [])
        code = f"""
        source {shlex.quote(str(script))}
        COMP_WORDS=({" ".join(map(shlex.quote, words))}); COMP_CWORD={len(words) - 1}
        COMP_LINE={shlex.quote(line)}; COMP_POINT={len(line)}
        entry=$(complete -p bayesnet-track); function=${{entry#*-F }}; function=${{function%% *}}
        $function bayesnet-track "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
        printf '%s\\n' "${{COMPREPLY[@]}}"
        """
        done = subprocess.run(
            [BASH, "--norc", "-c", code], capture_output=True, text=True, cwd=folder, check=True
        )
        assert done.stderr == ""
        return set(done.stdout.split())

    return offer


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("script") / "bayesnet-track"
    path.write_text(printed("bash"))
    return path


def printed(shell):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(["completion", shell]) == 0
    return out.getvalue()


@pytest.mark.skipif(BASH is None, reason="needs bash")
def test_bash_completes_commands_names_options_and_files(offered, script):
    assert {"run", "demo", "completion"} <= offered(script, "bayesnet-track ")
    assert offered(script, "bayesnet-track val") == {"validate"}
    assert offered(script, "bayesnet-track demo ") >= set(scene_names())
    assert offered(script, "bayesnet-track run kalman_") == {"kalman_ball", "kalman_detections"}
    assert offered(script, "bayesnet-track validate mi") == {"mine.yaml"}
    assert offered(script, "bayesnet-track validate ") >= {*graph_names(), "mine.yaml", "runs"}
    assert offered(script, "bayesnet-track demo --gr") == {"--graph"}
    assert "gray_square" in offered(script, "bayesnet-track demo --graph gra")
    assert offered(script, "bayesnet-track log ") == {"runs"}
    assert offered(script, "bayesnet-track detect color_b") == {"color_backprojection"}
    assert offered(script, "bayesnet-track run general --on-resize ") >= {"stop", "rescale"}
    assert offered(script, "bayesnet-track run general --source mine.t") == {"mine.txt"}


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_the_same_names(shell, tmp_path):
    text = printed(shell)
    assert all(name in text for name in (*graph_names(), *scene_names(), "validate"))
    program = shutil.which(shell)
    if program is not None:  # its own parser accepts it
        path = tmp_path / "script"
        path.write_text(text)
        subprocess.run([program, "-n", str(path)], check=True, capture_output=True)


def test_whatever_names_a_file_or_a_folder_is_completed():
    """Also in commands that are added later: by their words for the value."""
    named = [
        action
        for action in actions(make_parser())
        if action.nargs != 0 and action.choices is None and action.metavar in ("FILE", "RUN", "GRAPH", "DIR")
    ]
    assert len(named) > 20
    assert [action.dest for action in named if kind_of(action) is None] == []

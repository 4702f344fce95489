"""`compare` and `what-if` from the command line, on short runs of the demo."""

import json
import shutil

import pytest

from bayesnet_track import open_run
from bayesnet_track.cli.main import main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The first 40 frames of the demo: motion goes off, comes back, goes off."""
    out = tmp_path_factory.mktemp("compare") / "run"
    assert main(["demo", "--end", "40", "--quiet", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def higher(run):
    """What would have been with a higher level, and what was printed of it."""
    out = run.parent / "higher"
    setting = "square.adapt.activate.above.ud_px2=400"
    assert main(["what-if", str(run), "--set", setting, "--quiet", "--out", str(out)]) == 0
    return out


def run_command(capsys, *arguments):
    capsys.readouterr()
    code = main([str(one) for one in arguments])
    return code, *capsys.readouterr()


@pytest.mark.slow
def test_what_if_tells_where_it_parts(run, higher, capsys, tmp_path):
    page = tmp_path / "page.html"
    code, out, _ = run_command(capsys, "compare", run, higher, "--html", page)
    assert code == 0
    assert "targets.square.nodes.square.adapt.activate.above.ud_px2: 130 → 400" in out
    assert "they first diverge at frame 25, motion\n  A  frame 25: UD 144 px² > 130" in out
    assert "AUC" in out and "reconfigurations" in out
    assert "They first diverge at frame 25, motion" in page.read_text(encoding="utf-8")


def test_no_page_is_written_over_another_file_unasked(run, higher, capsys, tmp_path):
    page = tmp_path / "notes.html"
    page.write_text("mine")
    for command in (("compare", run, higher), ("what-if", run, "--seed", "1", "--out", tmp_path / "new")):
        code, _, err = run_command(capsys, *command, "--html", page)
        assert code == 6 and f"{page}: it is there already; --overwrite replaces it" in err
    assert page.read_text() == "mine" and not (tmp_path / "new").exists()
    assert run_command(capsys, "compare", run, higher, "--html", page, "--overwrite")[0] == 0
    assert page.read_text() != "mine"


def test_as_json(run, higher, capsys):
    code, out, _ = run_command(capsys, "compare", run, higher, "--json")
    read = json.loads(out)
    assert code == 0 and read["moments"][0]["frame"] == 25
    assert read["moments"][0]["first"][0]["event"] == "activated"
    assert read["totals"]["frames"] == [40.0, 40.0] and read["last_frames"] == [39, 39]


@pytest.mark.slow
def test_nothing_changed_gives_the_same_bytes(run, capsys, tmp_path):
    code, out, _ = run_command(capsys, "run", "--what-if", run, "--quiet", "--out", tmp_path / "again")
    assert code == 0 and "their decisions never diverge" in out
    assert (tmp_path / "again" / "journal.jsonl").read_bytes() == (run / "journal.jsonl").read_bytes()


@pytest.mark.slow
def test_another_seed_and_no_adaptation(run, capsys, tmp_path):
    code, out, _ = run_command(
        capsys, "what-if", run, "--seed", "4", "--no-adaptation", "--quiet", "--out", tmp_path / "always"
    )
    assert code == 0 and "seed: 0 → 4" in out
    assert {line.active for line in open_run(tmp_path / "always").metrics} == {("color", "motion")}


def test_runs_over_other_pictures_are_refused(run, capsys, tmp_path):
    other = tmp_path / "other"
    assert main(["demo", "--seed", "1", "--end", "8", "--quiet", "--out", str(other)]) == 0
    code, _, err = run_command(capsys, "compare", run, other)
    assert code == 2 and "scene:two_squares of seed 0 and scene:two_squares of seed 1" in err
    assert run_command(capsys, "compare", run, other, "--force")[0] == 0


@pytest.mark.slow
def test_each_what_if_gets_a_folder_of_its_own_unless_one_is_named(run, capsys, tmp_path):
    mine = tmp_path / "mine"
    shutil.copytree(run, mine)
    for number, name in enumerate(("mine-what-if", "mine-what-if-2", "mine-what-if-3"), start=1):
        code, out, _ = run_command(capsys, "what-if", f"{mine}/", "--seed", number, "--quiet")
        assert code == 0 and f"B  {tmp_path / name}\n" in out
    assert open_run(tmp_path / "mine-what-if-2").started.seed == 2
    named = "--out", tmp_path / "mine-what-if"
    code, _, err = run_command(capsys, "what-if", mine, "--seed", 4, "--quiet", *named)
    assert code == 6 and "a run is there already" in err
    assert run_command(capsys, "what-if", mine, "--seed", 4, "--quiet", "--overwrite")[0] == 0
    assert open_run(tmp_path / "mine-what-if").started.seed == 4
    assert not (tmp_path / "mine-what-if-4").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--set", "sqare.fuse=pool"], "nearest: square"),
        (["--out", "{run}"], "that is the run itself"),
    ],
)
def test_what_if_refuses(run, capsys, arguments, said):
    code, _, err = run_command(capsys, "what-if", run, *(one.format(run=run) for one in arguments))
    assert code == 2 and said in err


def test_a_run_without_its_recipe_cannot_be_run_again(run, capsys, tmp_path):
    shutil.copytree(run, tmp_path / "old")
    (tmp_path / "old" / "run.json").unlink()
    code, _, err = run_command(capsys, "what-if", tmp_path / "old")
    assert code == 2 and "no run.json in it" in err
    assert run_command(capsys, "compare", run, tmp_path / "old")[0] == 0  # by the source's name

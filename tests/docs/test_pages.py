"""What the pages show is true: commands run, graphs are valid, the cue of the page on cues is right."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import make_parser
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graphs import graph_names
from bayesnet_track.observation import cue_files, plugins

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs").glob("*/*.md"))]


def blocks(page, language):
    found = re.findall(rf"^ *```{language}\n(.*?)^ *```$", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return ["\n".join(line for line in block.splitlines()) for block in found]


def commands(page):
    """The lines of a page that call this program, without comments and what follows a pipe or `>`."""
    for block in blocks(page, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0].endswith("bayesnet-track"):
                ends = [n for n, word in enumerate(words) if word in (">", "|", "&&")]
                yield words[1 : min(ends, default=len(words))]


def name_of(page):
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_that_a_page_shows_can_be_parsed(page, capsys):
    """Words in capitals stand for numbers and files of one's own."""
    parser = make_parser()
    for words in commands(page):
        if any(re.fullmatch(r"\.\.\.|…|\[.*", word) for word in words):
            continue
        options = {"N": "3", "A:B": "3:5"}
        try:
            parser.parse_args([options.get(word, word) for word in words])
        except SystemExit as end:
            assert end.code == 0, f"{name_of(page)}: {shlex.join(words)}: {capsys.readouterr().err}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_piece_of_yaml_can_be_read(page):
    for block in blocks(page, "yaml"):
        value = yaml.safe_load(re.sub(r"\{\.\.\.\}", "{}", block))
        assert isinstance(value, dict | list), f"{name_of(page)}: {block}"
        if isinstance(value, dict) and "bayesnet" in value and "{...}" not in block:
            graph, _ = read_graph(block, name_of(page))
            assert graph.targets


def cloned():
    """The files that a clone of this repository has; all that are there where it is no repository."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        return {path.resolve() for path in ROOT.rglob("*")}
    files = {(ROOT / name).resolve() for name in listed.stdout.split("\0") if name}
    return files | {folder for file in files for folder in file.parents}


def test_every_link_between_pages_leads_somewhere_in_a_clone():
    """What is made when the pages are built is not there."""
    there, wrong, count = cloned(), [], 0
    for page in (*PAGES, *ROOT.glob("*.md"), *(ROOT / "changelog.d").glob("*.md")):
        base = ROOT if page.parent.name == "changelog.d" else page.parent  # fragments are gathered above
        text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
        for target in re.findall(r"""(?:\]\(|src="|href=")<?([^)#:\s">]+)[^)#:\s]*(?:#[^)]*)?[)"]""", text):
            count += 1
            if (base / target).resolve() not in there:
                wrong.append(f"{name_of(page)}: {target}")
    assert wrong == [] and count > 300


def test_each_integration_names_a_test_that_exists():
    text = (ROOT / "docs" / "integrations.md").read_text("utf-8")
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ")][1:]
    named = [re.search(r"`(tests/[\w/]+\.py)::(\w+)`", row[4]) for row in rows]
    assert len(rows) >= 15
    for row, found in zip(rows, named, strict=True):
        assert found, f"{row[0]} names no test"
        file = ROOT / found[1]
        assert file.is_file() and f"\ndef {found[2]}(" in file.read_text("utf-8"), found[0]


WRITE_A_CUE = ROOT / "docs" / "write_a_cue.md"


@pytest.fixture
def two_cues(tmp_path, monkeypatch):
    """A folder with the files of "Write a cue", in which its commands are given."""
    codes, graphs = blocks(WRITE_A_CUE, "python"), blocks(WRITE_A_CUE, "yaml")
    for name, code in (("glance.py", codes[0]), ("blur.py", codes[2])):
        (tmp_path / name).write_text(code + "\n")
    for name, graph in zip(("glanced.yaml", "blurred.yaml"), graphs, strict=True):
        (tmp_path / name).write_text(graph)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    plugins.forget()


def mean_iou(capsys, run):
    capsys.readouterr()
    assert main(["score", run, "--json"]) == 0
    return float(re.search(r'"mean_iou": ([0-9.]+)', capsys.readouterr().out)[1])


def test_the_first_cue_of_the_page_has_at_most_14_lines_and_loads(two_cues):
    lines = [line for line in (two_cues / "glance.py").read_text().splitlines() if line]
    assert len(lines) == 9 and "a cue of nine lines" in WRITE_A_CUE.read_text("utf-8")
    assert main(["validate", "glanced.yaml", "--cue-file", "glance.py"]) == 0
    exec(compile(blocks(WRITE_A_CUE, "python")[1], "write_a_cue", "exec"), {})


@pytest.mark.slow
def test_the_first_cue_of_the_page_tracks_by_its_one_command(two_cues, capsys):
    command = next(commands(WRITE_A_CUE))
    assert "--cue-file" in command and main([*command, "--quiet"]) == 0
    assert mean_iou(capsys, "runs/gray_square") > 0.5


@pytest.mark.slow
def test_the_package_of_the_page_is_found_and_tracks(two_cues, capsys, monkeypatch):
    (project,) = blocks(WRITE_A_CUE, "toml")
    about = two_cues / "blur_cue-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: blur-cue\nVersion: 1.0\n")
    points = re.search(r'entry-points."(.*)"\]\n(.*)\n', project)
    (about / "entry_points.txt").write_text(f"[{points[1]}]\n{points[2].replace(chr(34), '')}\n")
    monkeypatch.syspath_prepend(str(two_cues))
    plugins.forget()
    used = [words for words in commands(WRITE_A_CUE) if "--allow-plugins" in words]
    assert [words[0] for words in used] == ["list", "validate", "demo"]
    for words in used:
        assert main(words) == 0
    assert mean_iou(capsys, "runs/gray_square") > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glance", "blur"])
def test_the_cues_of_the_page_keep_to_the_contract(two_cues, name):
    suite = ROOT / "tests" / "cues" / "test_conformance.py"
    tried = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            suite,
            "-k",
            name,
            "-m",
            "slow or not slow",
            "-p",
            "no:cacheprovider",
        ],
        env={**os.environ, "BAYESNET_TRACK_TRY_CUES": str(two_cues / f"{name}.py")},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert tried.returncode == 0 and f"[{name}]" not in tried.stdout and "[100%]" in tried.stdout, (
        tried.stdout
    )


@pytest.mark.slow
def test_the_cue_of_the_contributing_page_works_as_a_file_and_as_a_built_in_one(
    tmp_path, monkeypatch, capsys
):
    page = ROOT / "CONTRIBUTING.md"
    short, whole, own_test = blocks(page, "python")
    (graph,) = blocks(page, "yaml")
    (tmp_path / "gray_cells.yaml").write_text(graph)
    monkeypatch.chdir(tmp_path)
    command = next(commands(page))
    for code in (short, whole):
        (tmp_path / "gray_cells.py").write_text(code)
        assert main([*command, "--quiet"]) == 0
        assert mean_iou(capsys, "runs/gray_square") > 0.5
        plugins.forget()
    declared = cue_files.load_cue_file("gray_cells.py").declaration
    monkeypatch.setitem(sys.modules, "bayesnet_track.cues.gray_cells", SimpleNamespace(CUE=declared))
    exec(compile(own_test, "test_gray_cells", "exec"), space := {})
    assert [name for name in space if name.startswith("test_")] == ["test_a_larger_sd_forgives_more"]


def test_the_pages_name_every_graph_of_the_library():
    text = "".join(page.read_text("utf-8") for page in PAGES)
    assert [name for name in graph_names() if name not in text] == []


def test_the_reference_tells_of_everything_that_the_package_offers():
    import bayesnet_track

    text = (ROOT / "docs" / "api.md").read_text("utf-8")
    missing = [
        name for name in bayesnet_track.__all__ if not re.search(rf"bayesnet_track\.{name}$", text, re.M)
    ]
    assert missing == []


GENERATED = {"language", "journal"}
"""Made from docstrings, which name sections of the thesis and have no links."""


def test_pages_that_rely_on_a_source_cite_it():
    for page in PAGES:
        text = page.read_text("utf-8")
        relies = re.search(
            r"\bthesis (?!of)|[Tt]racking chapter|General Distribution Filter", text, re.IGNORECASE
        )
        exempt = page.parent.name in GENERATED or page.name in {"api.md", "bibliography.md", "index.md"}
        if relies and page.parent != ROOT and not exempt:
            assert "bibliography.md#" in text, f"{name_of(page)}: {relies[0]}"


def test_the_citation_agrees_with_the_bibliography():
    text = " ".join((ROOT / "docs" / "bibliography.md").read_text("utf-8").split())
    for reference in yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["references"]:
        assert f"*{reference['title']}*" in text
        names = [f"{author['given-names']} {author['family-names']}" for author in reference["authors"]]
        assert " and ".join(names) in text

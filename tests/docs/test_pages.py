"""What the pages show is true: commands run, graphs are lawful, the cue of the page on cues is right."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from bayesnet_track.cli.parser import make_parser
from bayesnet_track.graph.text.read import read_graph
from bayesnet_track.graphs import graph_names

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


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_between_pages_leads_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text):
        if not target.startswith("gallery/"):  # made when the pages are built
            assert (page.parent / target).exists(), f"{name_of(page)}: {target}"


def package_of_the_page(folder):
    """The package of "Write a cue", installed in `folder`, and its graph."""
    page = ROOT / "docs" / "write_a_cue.md"
    (project,), (code,), (graph,) = (blocks(page, language) for language in ("toml", "python", "yaml"))
    about = folder / "glance_cue-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "glance.py").write_text(code)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: glance-cue\nVersion: 1.0\n")
    points = re.search(r'entry-points."(.*)"\]\n(.*)\n', project)
    (about / "entry_points.txt").write_text(f"[{points[1]}]\n{points[2].replace(chr(34), '')}\n")
    (folder / "glanced.yaml").write_text(graph)
    return folder


@pytest.mark.slow
def test_the_cue_of_the_page_works_and_keeps_to_the_contract(tmp_path):
    site = package_of_the_page(tmp_path / "site")
    environment = {**os.environ, "PYTHONPATH": str(site), "BAYESNET_TRACK_TRY_CUES": "glance"}

    def python(*words, cwd=tmp_path):
        return subprocess.run(
            [sys.executable, *map(str, words)], env=environment, cwd=cwd, capture_output=True, text=True
        )

    graph, allow = site / "glanced.yaml", ("--allow-plugins", "glance")
    checked = python("-m", "bayesnet_track", "validate", graph, *allow)
    assert checked.returncode == 0, checked.stderr
    line = ("demo", "gray_square", "--graph", graph, "--out", tmp_path / "run", "--quiet", *allow)
    assert python("-m", "bayesnet_track", *line).returncode == 0
    score = python("-m", "bayesnet_track", "score", tmp_path / "run", "--json")
    assert float(re.search(r'"mean_iou": ([0-9.]+)', score.stdout)[1]) > 0.5
    suite = ROOT / "tests" / "cues" / "test_conformance.py"
    tried = python(
        "-m", "pytest", suite, "-k", "glance", "-m", "slow or not slow", "-p", "no:cacheprovider", cwd=ROOT
    )
    assert tried.returncode == 0 and " passed" in tried.stdout, tried.stdout[-3000:]


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

"""Every piece of code of the pages runs, or a reason is given here why it cannot.

A page's code runs from top to bottom in one folder, `workplace`, which holds what the pages take for granted:
videos, ground truth, detections. Commands run in this process, Python in one namespace per page, and a
whole graph is written into `mine.yaml`. `test_pages` reads the rest of the YAML.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.observation import plugins
from bayesnet_track.observation.planes import Frame

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if not {"_build", "gallery"} & set(page.relative_to(ROOT).parts)]

OURS = "bayesnet-track"
NOT_CODE = {"toml", "md", "text", "json"}
ELSEWHERE = {
    "docs/write_a_cue.md": "test_pages installs the package of this page and runs its commands",
    "CONTRIBUTING.md": "changes the clone; test_pages tracks with the cue that it adds",
}
MEASURES = "measures for minutes or hours"
NOT_RUN = (
    (r"pip install|-m venv", "installs packages; CI does so by the README's commands"),
    (r"^python benchmarks/|^docs/.*benchmarks/", MEASURES),
    (r"--source 0\b|rtsp:", "needs a camera"),
    (r"--source north=", "needs the videos of two cameras; tests/runtime makes some"),
    (r"--view\b|wait_for_page|annotate (?!.*--no-view)", "waits for a browser; tests/browser has one"),
    (r"\bonnx\b|my_deep", "needs a network, and none is shipped; tests/vision makes one"),
    (r"^bayesnet-track calibrate (?!ground)", "needs pictures of a chessboard; tests/vision makes some"),
    (r"--calibration|learn-stereo", "needs two cameras; tests/cli renders a pair"),
    (r"learn-shape", "needs masks; tests/cli makes some"),
    (r"^rerun ", "opens a window"),
    (r"^mkdir ", "is a command of the shell"),
    (r"doctor", "checks the machine for a minute; tests/cli runs each check"),
    (r"--inputs runs/first", "needs a run that somebody took a hand in; tests/runtime repeats one"),
    (r"--rerun", "needs Rerun; tests/runtime writes a recording"),
    (r"--leave-one-out|--what policy|--motion|--fusion", "tracks for minutes; tests/cli has short forms"),
    (r"--guarantee|--alarm", "needs 19 videos; tests/cli runs both"),
    (r"--what sds", "needs several real videos; tests/evaluate fits scenes"),
)
WITH_LIBRARY = {
    "pandas": r"import pandas|agents\.",
    "matplotlib": "matplotlib",
    "supervision": "to_supervision",
    "h5netcdf": "--format arviz",
    "arviz": "arviz as az|posterior",
    "stonesoup": "stonesoup",
}
WORDS = {"GRAPH": "general", "RUN": "runs/mine", "DATA": "data", "[--truth": "", "FILE]": "", "--open": ""}
INIT = "57,21,31,45"

MINE = f"{OURS} run general --source video.mp4 --init {INIT} --out runs/mine"
BEFORE = {
    "docs/compare.md": [f"{OURS} init mine.yaml", MINE.replace("general", "mine.yaml")],
    "docs/export.md": [MINE],
    "docs/journal/measurements.md": [MINE],
    "docs/opencv.md": [MINE],
    "docs/scores.md": [f"{OURS} demo two_squares --out runs/mine"],
    "docs/notebook.md": [f"{OURS} demo"],
}
"""Page -> commands that it takes for done on other pages, or in prose."""


@dataclass(frozen=True)
class Piece:
    """A command, a block of Python, or a file (the kind is its name then), and where it stands."""

    page: str
    line: int
    kind: str
    code: str

    @property
    def reason(self) -> str | None:
        """Why it is not run."""
        if self.page in ELSEWHERE:
            return ELSEWHERE[self.page]
        return next((reason for pattern, reason in NOT_RUN if re.search(pattern, self.code)), None)

    @property
    def missing(self) -> list[str]:
        """Libraries that the package does not need, that it uses, and that are not here."""
        return [
            name
            for name, sign in WITH_LIBRARY.items()
            if re.search(sign, self.code) and find_spec(name) is None
        ]


def blocks(text: str) -> Iterator[tuple[int, str, list[str]]]:
    """First line, language ("" is none, "indented") and lines of each block of code."""
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        fence = re.match(r"( *)```(.*)", lines[at])
        if fence:
            end = next(n for n in range(at + 1, len(lines)) if lines[n].strip() == "```")
            yield at + 1, fence[2].strip(), [line[len(fence[1]) :] for line in lines[at + 1 : end]]
            at = end
        elif lines[at].startswith("    ") and (at == 0 or not lines[at - 1].strip()):
            end = next((n for n in range(at, len(lines)) if not lines[n].startswith("    ")), len(lines))
            yield at + 1, "indented", [line.strip() for line in lines[at:end]]
            at = end
        at += 1


def pieces(page: Path) -> list[Piece]:
    """What can be run; other text in blocks (formulas, what a program prints) is none."""
    name = str(page.relative_to(ROOT))
    found = []
    for line, language, code in blocks(page.read_text("utf-8")):
        if language == "yaml" and any(text.startswith("bayesnet:") for text in code):
            found.append(Piece(name, line, "mine.yaml", "\n".join(code)))
        elif code[0].startswith("source,"):
            found.append(Piece(name, line, "videos.csv", "\n".join(code)))
        elif code[0].startswith("time_s,sensor"):
            found.append(Piece(name, line, "sea.csv", "\n".join(code)))
        elif language == "yaml":
            continue
        elif language == "python":
            found.append(Piece(name, line, "python", "\n".join(code)))
        elif language not in NOT_CODE and not language.startswith("{"):
            joined = "\n".join(code).replace("\\\n", " ").splitlines()
            joined = [text.removeprefix(".venv/bin/") for text in joined]
            commands = [
                text for text in joined if re.match(rf"({OURS}|python3?|pip|pytest|rerun|\w+=) ?", text)
            ]
            if language == "sh":
                commands = [text for text in joined if text and not text.startswith("#")]
            found += [Piece(name, line, "command", text) for text in commands]
    return found


def words_of(command: str, page: str) -> list[str]:
    """The words of a command of this program: with files for what stands for them, few frames."""
    words = shlex.split(command, comments=True)
    ends = [n for n, word in enumerate(words) if word in (">", "|", "&&")]
    words = [WORDS.get(word, word) for word in words[1 : min(ends, default=len(words))]]
    words = [
        INIT if word in ("…", "...") and words[n - 1] == "--init" else word for n, word in enumerate(words)
    ]
    if words[0] in ("run", "demo"):
        words += ["--quiet"] * ("--quiet" not in words)
        words += ["--end", "125" if page == "README.md" else "55"]
    return [word for word in words if word]


def make_way(code: str, folder: Path) -> None:
    """Remove what an earlier command of the page wrote, where this one writes again."""
    names = re.findall(r"(?:--(?:out|html|video|svg) |\bout=\")([\w./-]+)", code)
    for name in names:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


EVERY = {str(page.relative_to(ROOT)): found for page in PAGES if (found := pieces(page))}
RUN = [name for name, found in EVERY.items() if any(piece.reason is None for piece in found)]


def test_few_pieces_are_not_run_and_each_has_its_reason():
    """What is run are commands of this program and Python; anything else needs a reason."""
    every = [piece for found in EVERY.values() for piece in found]
    strange = [piece for piece in every if piece.kind == "command" and not piece.code.startswith(OURS)]
    assert [piece for piece in strange if piece.reason is None] == []
    not_run = Counter(piece.reason for piece in every if piece.reason)
    assert sum(not_run[reason] for _, reason in NOT_RUN if reason != MEASURES) <= 36, not_run
    assert len(every) - sum(not_run.values()) >= 90
    patterns = {reason for _, reason in NOT_RUN} | set(ELSEWHERE.values())
    assert patterns == set(not_run), "a reason that nothing needs any more"


@pytest.mark.slow
@pytest.mark.parametrize("name", RUN)
def test_the_code_of_a_page_runs(name, workplace, monkeypatch):
    monkeypatch.chdir(workplace.folder)
    images = workplace.images
    space = {"frame": images[0], "next_frame": images[1]}
    if "FramePair" in "".join(piece.code for piece in EVERY[name]):
        space = {"frame": Frame(1, 1.0, images[1]), "previous": Frame(0, 0.0, images[0])}
    before = [Piece(name, 0, "command", code) for code in BEFORE.get(name, ())]
    for piece in [*before, *EVERY[name]]:
        if piece.reason is not None or piece.missing:
            continue
        make_way(piece.code, workplace.folder)
        if piece.kind == "python":
            exec(compile(piece.code, f"{name}:{piece.line}", "exec"), space)
        elif piece.kind == "command":
            assert main(words_of(piece.code, name)) == 0, f"{name}:{piece.line}: {piece.code}"
        else:
            (workplace.folder / piece.kind).write_text(piece.code + "\n", encoding="utf-8")
        plugins.forget()

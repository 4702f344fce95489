"""Row 12: hostile graph files, the library's mutated: a place for every error, in little work and memory."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graphs import find_graph, graph_names

pytestmark = pytest.mark.reliability
CASES, LIMIT_MB = 3000, 50
CALLS, CALLS_PER_CHARACTER = 100_000, 100
"""Calls that a text may cost: counted, because a clock also measures what else the machine does."""
PLACED = re.compile(r"g\.yaml:[1-9]\d*:[1-9]\d*: \S.*|g\.yaml: and more errors$")

HOSTILE = [
    "!!python/object/apply:os.system ['true']",
    "!!python/name:os.system",
    "!include /etc/passwd",
    "&a [*a]",
    "*nobody",
    "{<<: {a: 1}}",
    "[" * 200,
    "{" * 200,
    "{a: " * 100,
    "- " * 50,
    "? " * 50,
    "9" * 4000,
    "1:" * 2000 + "1",
    "1e999999",
    "-.inf",
    ".nan",
    "0x" + "f" * 100,
    "~",
    "''",
    '"\\u0000"',
    '"\\ud800"',
    "'" + "x" * 4090 + "'",
    "|\n" + " y\n" * 300,
    "[" + "a," * 3000 + "]",
    "{" + ",".join(f"k{n}: {n}" for n in range(2000)) + "}",
    "os.system",
    "bayesnet_track.cues.motion:CUE",
    "../../etc/passwd",
    "http://127.0.0.1:1/x.yaml",
    "/dev/zero",
    "${HOME}",
    "{{7*7}}",
    "%s%s%s%n",
    "\u202etxt",
    "\ufeff",
    "\x07",
    "é" * 500,
    "😀" * 100,
    "# ",
    "---",
    "...",
    "%YAML 9.9",
]
WORDS = re.compile(r"[A-Za-z_][A-Za-z_0-9]*|-?\d+(?:\.\d+)?")


def mutated(texts, rng):
    """A library graph with one to six hostile changes."""
    text = texts[rng.integers(len(texts))]
    for _ in range(rng.integers(1, 7)):
        lines = text.splitlines(keepends=True) or [""]
        at, other = rng.integers(0, len(lines), 2)
        words = list(WORDS.finditer(text)) or [re.match("", text)]
        word = words[rng.integers(len(words))]
        hostile = HOSTILE[rng.integers(len(HOSTILE))]
        match rng.integers(0, 12):
            case 0:  # a word is another one of the file
                again = words[rng.integers(len(words))].group()
                text = text[: word.start()] + again + text[word.end() :]
            case 1:  # or hostile
                text = text[: word.start()] + hostile + text[word.end() :]
            case 2:  # or misspelt
                text = text[: word.start()] + word.group()[::-1] + text[word.end() :]
            case 3:  # a line twice
                lines.insert(at, lines[other])
                text = "".join(lines)
            case 4:  # or not at all
                del lines[at]
                text = "".join(lines)
            case 5:  # or deeper
                lines[at] = " " * int(rng.integers(1, 9)) + lines[at]
                text = "".join(lines)
            case 6:  # or many times
                lines[at] = lines[at] * int(rng.integers(2, 200))
                text = "".join(lines)
            case 7:  # a piece is cut out
                low = int(rng.integers(0, len(text) + 1))
                text = text[:low] + text[low + int(rng.integers(1, 60)) :]
            case 8:  # or put in
                low = int(rng.integers(0, len(text) + 1))
                text = text[:low] + hostile + text[low:]
            case 9:  # a character is another one
                low = int(rng.integers(0, max(len(text), 1)))
                text = text[:low] + chr(int(rng.integers(1, 0x3000))) + text[low + 1 :]
            case 10:  # a number is another one
                number = ["0", "-1", "1e308", "1e-320", "999999999999", "0.1"][rng.integers(6)]
                text = text[: word.start()] + number + text[word.end() :]
            case _:  # two lines change places
                lines[at], lines[other] = lines[other], lines[at]
                text = "".join(lines)
    return text


def peak_mb():
    """The most memory that this process has had since the last `forget_peak`."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+)", status).group(1)) / 1024


def forget_peak():
    Path("/proc/self/clear_refs").write_text("5")


def examine(text):
    """The messages of a text, none when it is a graph; the calls it took, and the memory above before."""
    calls = 0

    def count(frame, event, argument):
        nonlocal calls
        calls += event in ("call", "c_call")

    forget_peak()
    before = peak_mb()
    sys.setprofile(count)
    try:
        spec, at = read_graph(text, "g.yaml")
        check(spec, at)
        said = []
    except GraphError as error:
        said = str(error).splitlines()
    finally:
        sys.setprofile(None)
    return said, calls, peak_mb() - before


@pytest.mark.parametrize("part", range(2))
def test_mutated_graphs(part):
    texts = [find_graph(name).read_text() for name in graph_names()]
    check(*read_graph(texts[0], "g.yaml"))  # what is imported late
    rng = np.random.default_rng([12, part])
    most, largest, refused = 0, 0.0, 0
    for case in range(CASES // 2):
        text = mutated(texts, rng)
        said, calls, memory = examine(text)
        refused += bool(said)
        most, largest = max(most, calls), max(largest, memory)
        assert all(PLACED.match(line) for line in said), (case, said)
        assert calls <= CALLS + CALLS_PER_CHARACTER * len(text), (case, calls, len(text), text[:2000])
        assert memory <= LIMIT_MB, (case, memory, text[:2000])
    print(f"{CASES // 2} graphs, {refused} refused; at most {most} calls, {largest:.1f} MB")
    assert refused > CASES // 2 * 0.8

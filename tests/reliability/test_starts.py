"""Runs started at the same moment with the same folder: one of them writes it, and the others say so."""

from __future__ import annotations

import hashlib
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType

import pytest

from bayesnet_track.cli.main import main

FRAMES = 4

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
PAIRS = [pytest.param(20, marks=pytest.mark.reliability), pytest.param(400, marks=pytest.mark.endurance)]


@pytest.fixture(scope="module")
def given(nursery: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("given")
    nursery.prepare(folder, FRAMES)
    return folder


Started = Callable[..., list[tuple[int, str]]]


@pytest.fixture(scope="module")
def started(nursery: ModuleType, given: Path) -> Iterator[Started]:
    """Exit code and texts of commands, started together, or one after the other by `apart_s` seconds."""
    process = nursery.Nursery(given)

    def call(commands: Sequence[Sequence[str]], texts: Path, apart_s: float = 0.0) -> list[tuple[int, str]]:
        start = time.time() + FORKED_S
        jobs = [
            nursery.Job(
                "command", str(texts / f"{n}"), arguments=tuple(arguments), start_at_s=start + n * apart_s
            )
            for n, arguments in enumerate(commands)
        ]
        codes, _ = process.ask(*jobs)
        return [(code, job.text_file.read_text()) for code, job in zip(codes, jobs, strict=True)]

    yield call
    process.close()


def command(given: Path, out: Path, *more: str) -> list[str]:
    graph, pictures = str(given / "graph.yaml"), str(given / "pictures")
    where = ["--source", pictures, "--init", "42,19,10,10", "--out", str(out)]
    return ["run", graph, *where, "--quiet", "--checkpoint-every", "0.001", *more]


FORKED_S = 0.15
"""Seconds in which both processes are forked on a busy machine, so that they start at one moment."""


def files(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.name not in ("timings.jsonl", "manifest.json")
    }


@pytest.mark.parametrize("pairs", PAIRS)
@pytest.mark.parametrize("more", [(), ("--overwrite",)], ids=["new", "overwrite"])
def test_pairs_of_starts_with_one_folder(
    tmp_path: Path, given: Path, started: Started, pairs: int, more: tuple[str, ...]
) -> None:
    """Exactly one of two new runs is done; of two that overwrite, at least one. Nothing is ever mixed."""
    assert main(command(given, tmp_path / "whole")) == 0
    whole, refused = files(tmp_path / "whole"), 0
    apart = random.Random(pairs)
    for pair in range(pairs):
        out = tmp_path / "run"
        if more:
            shutil.copytree(tmp_path / "whole", out)
        ended = started(
            [command(given, out, *more)] * 2, tmp_path, apart.choice((0.0, apart.uniform(0, 0.03)))
        )
        codes = sorted(code for code, _ in ended)
        assert codes == [0, 6] or (more and codes == [0, 0]), (pair, ended)
        for code, said in ended:
            if code == 6:
                assert "another process is writing this run" in said or "a run is there already" in said, said
                refused += "another process" in said
        assert files(out) == whole, pair
        shutil.rmtree(out)
    print(f"{pairs} pairs, {refused} refused by the lock")
    # Who comes a little later to a new folder mostly finds a run there, and no lock.
    assert refused > 0 or (not more and pairs < 400)


@pytest.mark.reliability
def test_a_run_and_a_resume_of_it_at_once(tmp_path: Path, given: Path, started: Started) -> None:
    assert main(command(given, tmp_path / "whole")) == 0
    whole = files(tmp_path / "whole")
    for number in range(10):
        out = tmp_path / "run"
        both = [command(given, out), ["resume", str(out), "--quiet"]]
        (began, _), (went_on, said) = started(both, tmp_path, 0.01 * number)
        assert began == 0 and went_on in (0, 4, 6), said
        assert files(out) == whole
        shutil.rmtree(out)

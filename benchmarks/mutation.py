"""Mutation testing of the four rooms of mathematics with mutmut, on mutants drawn by a recorded seed.

Needs `pip install mutmut==3.8.1` beside the test extra. Run from the checkout's root:

    python benchmarks/mutation.py --number 1500 --seed 20261122

Mutmut works on a copy, in `--folder`. The JIT is off, so that it sees the kernels as Python; there `compiled`
and the caches (`lru_cache`, `cache`) change no result and are taken off, because mutmut leaves decorated
functions alone. Not mutated: what `raise` says, properties, and `compiled.py`, which calls the JIT. A test
that fails or takes more than `--limit` CPU seconds with the JIT off is left out. Chunks are run in the order
of the draw. A second call in the same folder goes on where the first one ended, with the tests as they are
then; after a change of the package take another folder.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

PACKAGE = "bayesnet_track"
ROOMS = ("numerics", "belief", "inference", "adapt", "vision/kernels")
TESTS = (
    *("numerics", "belief", "inference", "adapt", "engine", "vision"),
    *(f"cues/test_{cue}.py" for cue in ["color_blobs", "color_histogram", "intensity", "klt", "mean_shift"]),
    *(f"cues/test_{cue}.py" for cue in ["motion", "shading", "shape", "texture"]),
    "observation/test_planes.py",
)
NOT_WITHOUT_JIT = ("belief/test_conformance.py", "belief/test_kalman_experiments.py")
DECORATOR = re.compile(r"^@(compiled|compiled_summing|cache|lru_cache\(.*\))\n", re.MULTILINE)
LEFT_OUT = "left_out.txt"
DRAWN = "drawn.txt"
LIMIT = "MUTATION_CPU_LIMIT"
KILLED = ("killed", "timeout", "segfault")
SETTINGS = """[tool.mutmut]
source_paths = ["bayesnet_track"]
only_mutate = {only}
do_not_mutate = ["bayesnet_track/numerics/compiled.py"]
do_not_mutate_patterns = ['^\\s*raise ']
pytest_add_cli_args = ["-p", "mutation", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:rerunfailures",
    "--hypothesis-profile=mutation"]
pytest_add_cli_args_test_selection = {tests}
timeout_multiplier = 10.0
timeout_constant = 2.0
use_git_change_detection = false

[tool.pytest.ini_options]
addopts = "-q --import-mode=importlib -m 'not slow and not reliability'"
filterwarnings = ["ignore"]
markers = ["slow: seconds", "reliability: minutes", "flaky: real time"]
"""


def main() -> None:
    """Draw the sample, let mutmut run it, print the table and the survivors."""
    options = _parse()
    root = Path.cwd()
    os.environ.update({"NUMBA_DISABLE_JIT": "1", LIMIT: str(options.limit)})
    _copy(root, options.folder)
    os.chdir(options.folder)
    sys.path.append(str(Path(__file__).resolve().parent))  # for `-p mutation`

    from mutmut.__main__ import _run
    from mutmut.stats import status_by_exit_code
    from mutmut.workers.isolation import ForkRunner

    ForkRunner.run_clean_tests = lambda self, tests: 0  # the pass that collects what calls what was one
    drawn = _drawn(options.seed, options.pilot + options.number)
    drawn = drawn[: options.pilot] if options.only_pilot else drawn[options.pilot :]
    for start in range(0, len(drawn), options.chunk):
        chunk = drawn[start : start + options.chunk]
        known = _results()
        retried = (None, 0, 33) if options.again else (None,)
        fresh = tuple(name for name in chunk if known[name] in retried)
        if fresh:
            _run(fresh, 1)
        known = _results()
        _show(drawn[: start + len(chunk)], {name: status_by_exit_code[known[name]] for name in drawn})


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--number", type=int, default=1500, help="how many mutants (default 1500)")
    parser.add_argument("--seed", type=int, default=20261122, help="of the draw (default 20261122)")
    parser.add_argument(
        "--pilot", type=int, default=300, help="mutants drawn before those, to write tests after"
    )
    parser.add_argument("--only-pilot", action="store_true", help="run the pilot instead of the sample")
    parser.add_argument(
        "--again", action="store_true", help="run survivors once more, after a change of tests"
    )
    parser.add_argument(
        "--limit", type=float, default=0.7, help="CPU seconds for a test, JIT off (default 0.7)"
    )
    parser.add_argument("--chunk", type=int, default=500, help="mutants between two tables (default 500)")
    parser.add_argument("--folder", type=Path, default=Path("build/mutation"), help="where mutmut works")
    return parser.parse_args()


def _copy(root: Path, folder: Path) -> None:
    """The package as it is installed, with plain kernels, its tests and the settings of mutmut and pytest."""
    skip = shutil.ignore_patterns("__pycache__")
    shutil.copytree(root / "tests", folder / "tests", ignore=skip, dirs_exist_ok=True)
    tests = [f"tests/{name}" for name in TESTS] + [f"--ignore=tests/{name}" for name in NOT_WITHOUT_JIT]
    (folder / "pyproject.toml").write_text(
        SETTINGS.format(only=[f"{PACKAGE}/{r}/*" for r in ROOMS], tests=tests)
    )
    if (folder / PACKAGE).exists():
        return
    shutil.copytree(root / PACKAGE, folder / PACKAGE, ignore=skip)
    for mapped in ("cues", "graphs"):
        shutil.copytree(root / mapped, folder / PACKAGE / mapped, ignore=skip)
    for path in _sources(folder):
        path.write_text(DECORATOR.sub("", path.read_text()))


def _sources(folder: Path) -> list[Path]:
    """The files of the rooms, but for the one that calls the JIT."""
    files = [path for room in ROOMS for path in sorted((folder / PACKAGE / room).rglob("*.py"))]
    return [path for path in files if path.name != "compiled.py"]


def _drawn(seed: int, number: int) -> list[str]:
    """What was drawn when the folder was made, or is drawn now."""
    if not Path(DRAWN).exists():
        Path(DRAWN).write_text("\n".join(_draw(seed, number)))
    return Path(DRAWN).read_text().split()


def _draw(seed: int, number: int) -> list[str]:
    """The names of the mutants drawn, in the order of the draw; mutmut writes no others.

    All the mutants of the rooms would be 800,000 lines, of which each process would hold every one.
    """
    from libcst import FunctionDef
    from mutmut import __main__ as mutmut
    from mutmut.mutation import file_mutation

    make = file_mutation.create_mutations
    found: list[tuple[str, int]] = []
    for path in _sources(Path()):
        count = sum(
            isinstance(m.contained_by_top_level_function, FunctionDef)
            for m in make(str(path), path.read_text())[1]
        )
        found += [(str(path), n) for n in range(count)]
    drawn = random.Random(seed).sample(found, number)
    print(f"{len(found)} mutants; {number} drawn with the seed {seed}", flush=True)

    def some(filename: str, *rest: Any) -> Any:
        module, mutations, *ignored = make(filename, *rest)
        inside = [m for m in mutations if isinstance(m.contained_by_top_level_function, FunctionDef)]
        return module, [m for n, m in enumerate(inside) if (filename, n) in wanted], *ignored

    wanted = set(drawn)
    file_mutation.create_mutations = some
    Path("mutants").mkdir(exist_ok=True)
    mutmut.copy_src_dir()
    mutmut.copy_also_copy_files()
    mutmut.create_mutants(1)
    made = {str(data.path): iter(data.exit_code_by_key) for data in _data()}
    names = {one: next(made[one[0]]) for one in sorted(drawn)}  # both in the order of the source
    return [names[one] for one in drawn]


def _data() -> list[Any]:
    """What mutmut keeps of each source file."""
    from mutmut.__main__ import collect_source_file_mutation_data

    return list(collect_source_file_mutation_data(mutant_names=())[1].values())


def _results() -> dict[str, int | None]:
    """The exit code of every mutant, None where it has not run."""
    return {name: code for data in _data() for name, code in data.exit_code_by_key.items()}


def _show(names: Sequence[str], status: dict[str, str]) -> None:
    """The table by room, and every survivor."""
    rooms = {room.split("/")[0]: Counter[str]() for room in (*ROOMS, "all")}
    for name in names:
        for room in (name.split(".")[1], "all"):
            rooms[room][status[name]] += 1
    print("\n| room | mutants | killed | survived | without a test | killed, % |\n|---|---|---|---|---|---|")
    for room, counts in rooms.items():
        total, killed = counts.total(), sum(counts[name] for name in KILLED)
        share = f"{100 * killed / total:.1f}" if total else ""
        print(f"| {room} | {total} | {killed} | {counts['survived']} | {counts['no tests']} | {share} |")
    others = Counter({name: n for name, n in rooms["all"].items() if name not in ("survived", "no tests")})
    print(dict(others), flush=True)
    survivors = [name for name in names if status[name] not in KILLED]
    Path("survivors.txt").write_text("".join(f"{status[name]} {name}\n" for name in survivors))


# What follows is loaded by pytest, as the plugin `mutation`.


settings.register_profile(  # finds what it finds at once: a kill need not be shrunk
    "mutation",
    max_examples=10,
    derandomize=True,
    deadline=None,
    database=None,
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=list(HealthCheck),
)


class TooSlow(BaseException):
    """A test took more CPU time than the limit."""


def _left_out() -> set[str]:
    path = Path("..") / LEFT_OUT
    return {line.split("\t")[0] for line in path.read_text().splitlines()} if path.exists() else set()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what was too slow or failed before anything was mutated."""
    gone = _left_out()
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid in gone])
    items[:] = [item for item in items if item.nodeid not in gone]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """While mutmut collects which test calls what, limit what fixtures take."""
    return (yield from _limited(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Likewise for the test."""
    return (yield from _limited(item))


def _limited(item: pytest.Item) -> Iterator[None]:
    """Skip a test that fails or takes too long before anything is mutated, and note it."""
    if os.environ.get("MUTANT_UNDER_TEST") != "stats":
        return (yield)
    signal.signal(signal.SIGPROF, _give_up)
    signal.setitimer(signal.ITIMER_PROF, float(os.environ[LIMIT]))
    try:
        return (yield)
    except pytest.skip.Exception:
        raise
    except BaseException as error:
        _note(item, error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _note(item: pytest.Item, error: BaseException) -> None:
    with (Path("..") / LEFT_OUT).open("a") as file:
        file.write(f"{item.nodeid}\t{type(error).__name__}\n")
    pytest.skip(f"{type(error).__name__} with the JIT off")


def _give_up(*_: Any) -> None:
    raise TooSlow


if __name__ == "__main__":
    main()

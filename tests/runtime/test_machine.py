"""A run goes on where its numbers stay the same; elsewhere only if allowed, and the journal says so."""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.runs import MachineChanged, RunEnded
from bayesnet_track.runtime.checkpoints.origins import describe_machine, name_differences
from bayesnet_track.runtime.checkpoints.resume import ResumeError, resume
from bayesnet_track.sources.scenes.library import SceneSource

FRAMES = 6


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run that was broken off after three frames."""
    source = SceneSource.named("two_squares", 0, FRAMES)
    results = track("two_squares", source, [Start(source.scene.start_box)], out=tmp_path / "run")
    for _ in itertools.islice(results, 3):
        pass
    results.close()
    return tmp_path / "run"


def elsewhere(monkeypatch: pytest.MonkeyPatch, change: Mapping[str, str]) -> None:
    """From now on this is another machine."""
    other = {**describe_machine(), **change}
    for module in ("checkpoint", "resume"):
        monkeypatch.setattr(f"bayesnet_track.runtime.checkpoints.{module}.describe_machine", lambda: other)


def content(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("NumPy CPU", "none", "NumPy CPU: without .* with none"),
        ("Numba target", "generic", "Numba target .*, now generic"),
        ("OpenCV build", "0123", "OpenCV build .*, now 0123"),
        ("numpy", "1.0", r"numpy .*, now 1\.0"),
        ("machine", "Plan9 vax", "machine .*, now Plan9 vax"),
    ],
)
def test_elsewhere_it_is_refused_with_what_differs_and_nothing_changes(
    run: Path, part: str, value: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(run)
    elsewhere(monkeypatch, {part: value})
    with pytest.raises(ResumeError, match=words):
        list(resume(run))
    assert content(run) == before


def test_where_it_is_allowed_it_goes_on_and_the_journal_says_so(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere(monkeypatch, {"numpy": "1.0"})
    assert main(["resume", str(run), "--quiet"]) == 4
    assert "now 1.0; --allow-other-machine" in capsys.readouterr().err
    results = resume(run, allow_other_machine=True)
    next(results)
    results.close()
    # What is done from now on is done on one machine.
    assert main(["resume", str(run), "--quiet"]) == 0
    events = open_run(run).events
    moved = [event for event in events if isinstance(event, MachineChanged)]
    assert [event.frame for event in moved] == [3]
    assert len(moved[0].changes) == 1 and "now 1.0" in moved[0].changes[0]
    assert isinstance(events[-1], RunEnded) and events[-1].complete
    assert main(["log", str(run)]) == 0
    assert "frame 3: the run continues on another machine" in capsys.readouterr().out


def test_a_run_without_a_checkpoint_is_compared_by_its_versions(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run / "checkpoint").unlink()
    monkeypatch.setattr("bayesnet_track.runtime.checkpoints.resume.versions", lambda: {"numpy": "1.0"})
    with pytest.raises(ResumeError, match=r"numpy .*, now 1\.0"):
        list(resume(run))


def test_instruction_sets_are_told_by_what_is_gone_and_what_is_new() -> None:
    assert name_differences({"a CPU": "SSE AVX"}, {"a CPU": "SSE FMA"}) == ("a CPU: without AVX, with FMA",)
    assert name_differences({"b": "1"}, {"c": "2"}) == ("b 1, now none", "c none, now 2")
    assert name_differences(describe_machine(), describe_machine()) == ()


@pytest.mark.slow
def test_a_processor_with_fewer_instruction_sets_is_noticed(run: Path) -> None:
    """Not patched: the libraries are told to use less, as they would on an older processor."""
    here = describe_machine()
    dispatched = here["NumPy CPU"].split()[1:]
    if not dispatched or "AVX2" not in here["OpenCV CPU"]:
        pytest.skip("this processor has no more than the baseline")
    less = {"NPY_DISABLE_CPU_FEATURES": " ".join(dispatched), "OPENCV_CPU_DISABLE": "AVX2"}

    def resumed(settings: Mapping[str, str], *options: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "bayesnet_track", "resume", str(run), "--quiet", *options]
        return subprocess.run(
            command, env={**os.environ, **settings}, capture_output=True, text=True, check=False
        )

    before = content(run)
    refused = resumed({**less, "NUMBA_CPU_NAME": "generic"})
    assert refused.returncode == 4, refused.stderr
    for words in (f"NumPy CPU: without {dispatched[0]}", "OpenCV CPU: without", "AVX2", "now", "generic"):
        assert words in refused.stderr
    assert content(run) == before
    allowed = resumed(less, "--allow-other-machine")
    assert allowed.returncode == 0, allowed.stderr
    (moved,) = [e for e in open_run(run).events if isinstance(e, MachineChanged)]
    assert any(change.startswith("OpenCV CPU: without") and "AVX2" in change for change in moved.changes)

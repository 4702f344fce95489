"""Runs that are begun, killed, resumed, switched, overwritten, edited and verified in any order.

A model says after each of them what must be on the disk. Hypothesis looks for an order that proves it wrong.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from bayesnet_track import Result, Start, track
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.resume import inputs_before, resume
from bayesnet_track.runtime.checkpoints.standing import verify
from bayesnet_track.runtime.recording.manifest import ManifestError, passing
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.sources.sources import open_source

FRAMES = 8
SEEDS = (0, 1)
"""A run that overwrites another has the other seed."""
OUTPUTS = ("frames.npy.gz", "graph.yaml", "journal.jsonl", "run.json", "tracks.txt")
OUTPUTS += ("timings.jsonl", "video.mkv", "manifest.json", "inputs.jsonl")

Switches = dict[int, tuple[Toggled | Released, ...]]
Results = Generator[Result, None, None]

pytestmark = [
    pytest.mark.endurance,
    # PyAV cannot pass on that a run is killed while it writes the video.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@dataclass
class Given:
    """What all runs share: graph and pictures, and unbroken runs, each made when it is first asked for."""

    folder: Path
    place: Callable[[int], tuple[int, int]]
    steps: ModuleType
    whole: dict[object, Path] = field(default_factory=dict)

    def track(self, out: Path, seed: int, **options: Any) -> Results:
        box = (*map(float, self.place(0)), 10.0, 10.0)
        with open_source(str(self.folder / "pictures")) as source:
            graph = self.folder / "graph.yaml"
            yield from track(graph, source, [Start(box)], out=out, seed=seed, video=True, **options)

    def unbroken(self, seed: int, switches: Switches) -> Path:
        """The run directory of an unbroken run with these switches."""
        key = (seed, tuple(sorted(switches.items())))
        if key not in self.whole:
            folder = self.folder / f"whole{len(self.whole)}"
            given = dict(switches)
            for _ in self.track(folder, seed, inputs=lambda frame: given.get(frame, ())):
                pass
            self.whole[key] = folder
        return self.whole[key]


@dataclass
class Run:
    """The run that must be on the disk.

    Attributes:
        seed: its seed.
        switches: by frame, what was asked for by hand and must never be lost again.
        is_finished: whether its manifest is there.
        goes_on: the first frame that may be tracked when it is resumed, at the least.
    """

    seed: int
    switches: Switches = field(default_factory=dict)
    is_finished: bool = False
    goes_on: int = 0


@dataclass(frozen=True)
class Break:
    """How a call ends before its time, and how often it makes checkpoints.

    Attributes:
        killed_at: step on the disk at which it is killed; 0 for never.
        stopped_after: frames after which the caller stops; more than there are for never.
        every_s: seconds between checkpoints.
    """

    killed_at: int
    stopped_after: int
    every_s: float


@st.composite
def asked(draw: st.DrawFn) -> Switches:
    """What a person asks for, by frame; not in the first, in which an agent has to start.

    For frames that never come nobody is asked.
    """

    def one(frame: int) -> Toggled | Released:
        node = draw(st.sampled_from(("gray", "moves")))
        is_on = draw(st.sampled_from((True, False, None)))
        return Released(frame, "1", node) if is_on is None else Toggled(frame, "1", node, is_on)

    frames = draw(st.lists(st.integers(1, FRAMES + 2), min_size=1, max_size=4, unique=True))
    return {frame: tuple(one(frame) for _ in range(draw(st.integers(1, 2)))) for frame in sorted(frames)}


breaks = st.builds(
    Break,
    st.one_of(st.just(0), st.integers(1, 60), st.integers(30, 190)),
    st.integers(1, FRAMES + 4),
    st.sampled_from((1e-6, 0.0, 1000.0)),
)


def held(folder: Path) -> dict[str, bytes]:
    """The files of a run, but for the lock."""
    if not folder.exists():
        return {}
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != ".lock"
    }


def outputs(folder: Path) -> dict[str, bytes | int]:
    """What equal runs have in common: of times and of the manifest that vouches for them, the lines."""
    return {
        name: data.count(b"\n") if name in ("timings.jsonl", "manifest.json") else data
        for name, data in held(folder).items()
    }


class Machine(RuleBasedStateMachine):
    """One run directory, and the model of what must be in it."""

    def __init__(self, given: Given) -> None:
        super().__init__()
        self.given = given
        self.folder = Path(tempfile.mkdtemp(dir=given.folder)) / "run"
        self.run: Run | None = None
        self.is_replacing = False
        self.edited: tuple[str, str, bytes] | None = None
        """Name of an output, what `verify` finds of it, and what it was."""

    @rule(switches=asked(), how=breaks)
    def begin(self, switches: Switches, how: Break) -> None:
        """A new run; in place of the one that is there, if any."""
        old, before, is_whole = self.run, held(self.folder), not self.is_replacing
        new = Run(SEEDS[0] if old is None else 1 - old.seed)
        is_new = self._call(
            new,
            switches,
            how,
            lambda asked: self.given.track(
                self.folder, new.seed, overwrite=True, inputs=asked, checkpoint_every=how.every_s
            ),
        )
        if not is_new and old is not None and is_whole:
            assert held(self.folder) == before, "the earlier run is untouched"

    @precondition(lambda self: self.run is not None and not self.run.is_finished)
    @rule(switches=asked(), how=breaks)
    def go_on(self, switches: Switches, how: Break) -> None:
        """Resume."""
        assert self.run is not None
        self._call(
            self.run,
            switches,
            how,
            lambda asked: resume(self.folder, inputs=asked, checkpoint_every=how.every_s),
        )

    @precondition(lambda self: self.run is None or self.run.is_finished)
    @rule()
    def go_on_with_nothing(self) -> None:
        """Resume is refused where there is no run, and does nothing where it is finished."""
        before = held(self.folder)
        if self.run is None:
            with pytest.raises(RecipeError):
                list(resume(self.folder))
        else:
            try:
                assert list(resume(self.folder)) == []
            except (ManifestError, RecipeError):
                assert self.edited is not None
        now = held(self.folder)
        assert now == {name: data for name, data in before.items() if name in now}
        assert before.keys() - now.keys() <= (passing() if self.run is not None else set())

    @precondition(lambda self: self.run is not None and not self.is_replacing)
    @rule()
    def begin_without_leave(self) -> None:
        """A new run that may not overwrite the one that is there."""
        before = held(self.folder)
        with pytest.raises(RunDirectoryError, match="a run is there already"):
            list(self.given.track(self.folder, 0))
        assert held(self.folder) == before

    @precondition(lambda self: self.run is not None and self.run.is_finished and self.edited is None)
    @rule(
        name=st.sampled_from(OUTPUTS),
        how=st.sampled_from(("flipped", "cut", "grown", "removed")),
        place=st.integers(0, 1 << 16),
    )
    def edit(self, name: str, how: str, place: int) -> None:
        """Somebody changes an output of a finished run."""
        path = self.folder / name
        if not path.exists() or self.run is None:
            return
        data = path.read_bytes()
        finding = {"flipped": "changed", "cut": "truncated", "grown": "changed", "removed": "missing"}[how]
        if how == "removed":
            path.unlink()
            if name == "manifest.json":
                self.run = Run(self.run.seed, self.run.switches)
                return
        elif how == "flipped":
            place %= len(data)
            path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        else:
            path.write_bytes(data[:-1] if how == "cut" else data + b"\n")
        self.edited = (name, finding, data)

    @precondition(lambda self: self.edited is not None)
    @rule()
    def mend(self) -> None:
        """It is put back as it was."""
        assert self.edited is not None
        name, _, data = self.edited
        (self.folder / name).write_bytes(data)
        self.edited = None

    @invariant()
    def verify_says_so(self) -> None:
        """`verify` says what the model says, and changes nothing."""
        before = held(self.folder)
        if self.run is None:
            with pytest.raises(RecipeError):
                verify(self.folder)
        elif self.edited is not None and self.edited[0] == "manifest.json":
            with pytest.raises(ManifestError):
                verify(self.folder)
        else:
            found = verify(self.folder)
            expected = "verified" if self.run.is_finished else "unfinished"
            wrong = {name: one for name, one in found.outputs.items() if one != "ok"}
            assert found.status == (expected if self.edited is None else "changed")
            assert wrong == ({} if self.edited is None else {self.edited[0]: self.edited[1]})
        assert held(self.folder) == before

    def teardown(self) -> None:
        """Whatever was done to it, in the end it is an unbroken run."""
        try:
            if self.run is not None and not self.run.is_finished:
                self.go_on({}, Break(0, FRAMES + 1, 1e-6))
                assert self.run.is_finished
        finally:
            shutil.rmtree(self.folder.parent)

    def _call(
        self,
        run: Run,
        switches: Switches,
        how: Break,
        call: Callable[[Callable[[int], Any]], Results],
    ) -> bool:
        """Begin or resume `run`, and bring the model up to date; whether `run` is on the disk then."""
        life, asked_frames, done = self.given.steps.Life(how.killed_at), list[int](), list[int]()

        def inputs(frame: int) -> tuple[Toggled | Released, ...]:
            asked_frames.append(frame)
            return switches.get(frame, ())

        with pytest.MonkeyPatch.context() as patch:
            self.given.steps.restored(patch)
            life.install()
            results = call(inputs)
            try:
                for result in results:
                    if not done:
                        assert verify(self.folder).status == "running"
                    done.append(result.frame.index)
                    if len(done) == how.stopped_after:
                        break
                results.close()
            except (Exception, self.given.steps.Killed):
                if not life.is_dead:
                    raise
        is_there = self._heed(run, life.commits)
        if done:
            assert is_there, "a run is on the disk with its first frame"
            assert done == list(range(done[0], done[0] + len(done))) and done[0] >= run.goes_on
        if not is_there:
            return False
        if not self.is_replacing:
            run.switches = self._kept(run.switches, switches, asked_frames, done)
        is_stopped = len(done) == how.stopped_after and not life.is_dead
        if done and (how.every_s == 1e-6 or (is_stopped and how.every_s)):
            run.goes_on = done[-1] + 1
        assert run.is_finished or life.is_dead or is_stopped
        if run.is_finished and not life.is_dead:
            self._compare(run)
        return True

    def _heed(self, run: Run, commits: list[str]) -> bool:
        """What the renames of a call decided; whether `run` is on the disk."""
        if self.is_replacing:  # it was completed first
            done = commits.index(".staged") + 1 if ".staged" in commits else len(commits)
            self.is_replacing, commits = ".staged" not in commits, commits[done:]
        if run is not self.run:
            if not {"run.json", ".replacing"} & {*commits}:
                return False
            self.run, self.edited = run, None
            self.is_replacing = ".replacing" in commits and ".staged" not in commits
        run.is_finished = "manifest.json" in commits
        return True

    def _kept(self, known: Switches, asked: Switches, asked_frames: list[int], done: list[int]) -> Switches:
        """The switches on the disk: all of those known, of those asked for each in a frame that was done."""
        found: Mapping[int, Any] = inputs_before(RunDirectory(self.folder))
        now = {frame: tuple(given) for frame, given in found.items()}
        assert {frame: now.get(frame) for frame in known} == known, "no switch is lost"
        for frame in range(FRAMES):
            if frame in known or (frame not in asked and frame not in now):
                continue
            given = asked.get(frame, ()) if frame in asked_frames else ()
            length = len(given) if frame in done else len(now.get(frame, ()))
            assert now.get(frame, ()) == given[:length], frame
        return now

    def _compare(self, run: Run) -> None:
        whole = self.given.unbroken(run.seed, run.switches)
        assert outputs(self.folder) == outputs(whole)
        assert verify(self.folder).result == verify(whole).result


@pytest.fixture(scope="module")
def given(nursery: ModuleType, steps: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Given:
    cv2.setNumThreads(1)
    folder = tmp_path_factory.mktemp("given")
    nursery.prepare(folder, FRAMES)
    return Given(folder, nursery.place, steps)


@pytest.mark.usefixtures("at_once")
def test_any_order_leaves_what_the_model_says(given: Given) -> None:
    run_state_machine_as_test(
        lambda: Machine(given),
        settings=settings(
            max_examples=100,
            stateful_step_count=15,
            derandomize=True,
            deadline=None,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
        ),
    )
    assert len(given.whole) > 10

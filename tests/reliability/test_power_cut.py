"""The power fails at every write, sync, rename and removal: what was not synced is lost, in every mix.

The operations of a run on its disk are recorded once. Then the disk is rebuilt as a power cut after each of
them could leave it, and the run is resumed there.
"""

from __future__ import annotations

import hashlib
import io
import random
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import pytest

from bayesnet_track.journal import disk
from bayesnet_track.runtime.checkpoints.recipe import RecipeError
from bayesnet_track.runtime.checkpoints.resume import resume

FRAMES, EVERY_S = 4, 1e-6
Work = Callable[[Path], None]

pytestmark = [
    pytest.mark.reliability,
    pytest.mark.skipif(sys.platform == "win32", reason="names of open files cannot be removed there"),
]


@dataclass
class Node:
    """A file or a folder: what the disk has for certain, and what was done since."""

    entries: dict[str, Node] | None = None
    content: bytes = b""
    changes: list[tuple[int, Any]] = field(default_factory=list)

    def child(self, name: str) -> Node | None:
        now = dict(self.entries or {})
        for _, (changed, node) in self.changes:
            now[changed] = node
        return now.get(name)


def read_tree(path: Path) -> Node:
    if path.is_dir():
        return Node({one.name: read_tree(one) for one in path.iterdir() if one.name != ".lock"})
    return Node(content=path.read_bytes())


class Tape:
    """Records what is done to a folder through `disk`: functions that do the same to a model of it."""

    def __init__(self, root: Path) -> None:
        self.root, self.before = root, read_tree(root) if root.exists() else Node({})
        self.steps: list[Callable[[Node, int], None]] = []

    def node(self, model: Node, path: Path) -> Node:
        for name in path.relative_to(self.root).parts:
            found = model.child(name)
            assert found is not None, path
            model = found
        return model

    def entry(self, path: Path, give: Callable[[Node], Node | None]) -> None:
        def step(model: Node, at: int) -> None:
            self.node(model, path.parent).changes.append((at, (path.name, give(model))))

        self.steps.append(step)

    def data(self, path: Path, node: list[Node], change: tuple[str, int, bytes]) -> None:
        self.steps.append(lambda model, at: node[-1].changes.append((at, change)))

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        tape = self
        replace, unlink, sync, sync_folder = disk.replace, disk.unlink, disk.sync, disk.sync_folder
        make_folder, remove_folder = disk.make_folder, disk.remove_folder

        class File(io.FileIO):
            def __init__(self, path: Path, mode: str) -> None:
                is_new = not path.exists()
                super().__init__(str(path), mode.replace("b", ""))
                self.path, self.held = path, []
                if is_new:
                    tape.entry(path, lambda model: Node())
                tape.steps.append(lambda model, at: self.held.append(tape.node(model, path)))
                if "w" in mode and not is_new:
                    tape.data(path, self.held, ("cut", 0, b""))

            def write(self, data: Any) -> int:
                at = self.tell()
                done = super().write(data) or 0
                tape.data(self.path, self.held, ("write", at, bytes(data)[:done]))
                return done

            def truncate(self, size: int | None = None) -> int:
                size = self.tell() if size is None else size
                tape.data(self.path, self.held, ("cut", size, b""))
                return super().truncate(size)

        def synced(file: Any) -> None:
            sync(file)
            tape.steps.append(lambda model, at: settle(file.held[-1]))

        def folder_synced(folder: Path) -> None:
            sync_folder(folder)
            if folder.is_relative_to(tape.root):
                tape.steps.append(lambda model, at: settle(tape.node(model, folder)))

        def renamed(source: Path, target: Path) -> None:
            replace(source, target)

            def step(model: Node, at: int) -> None:
                moved = tape.node(model, source)
                tape.node(model, target.parent).changes.append((at, (target.name, moved)))
                tape.node(model, source.parent).changes.append((at, (source.name, None)))

            tape.steps.append(step)

        def removed(path: Path) -> None:
            is_there = path.exists()
            unlink(path)
            if is_there:
                tape.entry(path, lambda model: None)

        def made(path: Path) -> None:
            make_folder(path)
            tape.entry(path, lambda model: Node({}))

        def folder_removed(path: Path) -> None:
            remove_folder(path)
            tape.entry(path, lambda model: None)

        for name, call in {
            "open_raw": File,
            "sync": synced,
            "sync_folder": folder_synced,
            "replace": renamed,
            "unlink": removed,
            "make_folder": made,
            "remove_folder": folder_removed,
        }.items():
            monkeypatch.setattr(disk, name, call)

    def after(self, count: int) -> Node:
        """The model after so many steps."""
        model = copied(self.before)
        for at, step in enumerate(self.steps[:count]):
            step(model, at)
        return model


def copied(node: Node) -> Node:
    if node.entries is None:
        return Node(content=node.content)
    return Node({name: copied(one) for name, one in node.entries.items()})


def settle(node: Node) -> None:
    """All that was done to it is on the disk."""
    if node.entries is None:
        node.content = written(node.content, [change for _, change in node.changes])
    else:
        for _, (name, child) in node.changes:
            if child is None:
                node.entries.pop(name, None)
            else:
                node.entries[name] = child
    node.changes.clear()


def written(content: bytes, changes: list[tuple[str, int, bytes]]) -> bytes:
    data = bytearray(content)
    for kind, at, new in changes:
        if kind == "cut":
            data = data[:at].ljust(at, b"\0")
        else:
            data = data.ljust(at, b"\0")
            data[at : at + len(new)] = new
    return bytes(data)


Keeps = Callable[[list[tuple[int, Any]]], list[Any]]


def nothing(changes: list[tuple[int, Any]]) -> list[Any]:
    return []


def everything(changes: list[tuple[int, Any]]) -> list[Any]:
    return [change for _, change in changes]


def torn(changes: list[tuple[int, Any]]) -> list[Any]:
    kept = everything(changes)
    if kept and kept[-1][0] == "write":
        kept[-1] = ("write", kept[-1][1], kept[-1][2][: len(kept[-1][2]) // 2])
    return kept


def zeros(changes: list[tuple[int, Any]]) -> list[Any]:
    return [(kind, at, bytes(len(new))) for _, (kind, at, new) in changes]


def some(seed: int) -> Keeps:
    rng = random.Random(seed)
    return lambda changes: [change for _, change in changes if rng.random() < 0.5]


def first(seed: int, steps: int) -> Keeps:
    """File systems keep the order of names: those up to some step."""
    last = random.Random(seed).randrange(steps + 1)
    return lambda changes: [change for at, change in changes if at < last]


def build(node: Node, path: Path, of_data: Keeps, of_names: Keeps) -> None:
    """Write what the disk holds after the cut."""
    if node.entries is None:
        path.write_bytes(written(node.content, of_data(node.changes)))
        return
    path.mkdir()
    names: dict[str, Node | None] = dict(node.entries)
    for name, child in of_names(node.changes):
        names[name] = child
    for name, child in names.items():
        if child is not None:
            build(child, path / name, of_data, of_names)


def files(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.is_file() and path.name not in ("timings.jsonl", "manifest.json", ".lock")
    }


@pytest.fixture(autouse=True)
def in_order(at_once: None) -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="module")
def pictures(nursery: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two sources, so that an earlier run and the one that replaces it differ."""
    made = {}
    for name, frames in (("new", FRAMES), ("old", FRAMES - 1)):
        made[name] = tmp_path_factory.mktemp(name)
        nursery.prepare(made[name], frames)
    return made


def every_cut(tape: Tape, tmp_path: Path, check: Callable[[Path], str]) -> Counter[str]:
    """What `check` says of the disk after each step, with each way to lose what was not synced."""
    outcomes: Counter[str] = Counter()
    for count in range(len(tape.steps) + 1):
        ways: dict[str, tuple[Keeps, Keeps]] = {
            "all that was not synced is lost": (nothing, nothing),
            "names are kept, contents lost": (nothing, everything),
            "contents are kept, names lost": (everything, nothing),
            "the last write is torn": (torn, everything),
            "what was not synced is zeros": (zeros, everything),
            "some are lost": (some(count), first(count, count)),
        }
        for number, (name, way) in enumerate(ways.items()):
            folder = tmp_path / f"{count}-{number}"
            build(tape.after(count), folder, *way)
            try:
                outcomes[check(folder)] += 1
            except (AssertionError, OSError, ValueError) as error:
                raise AssertionError(f"step {count} of {len(tape.steps)}, {name}: {error}") from error
            shutil.rmtree(folder)
    return outcomes


def recovered(folder: Path, go_on: Work, begin: Work, whole: dict[str, str]) -> str:
    """How a run came back."""
    try:
        go_on(folder)
        outcome = "resumed"
    except RecipeError:
        assert not (folder / "run.json").exists(), "what was asked for is written whole or not at all"
        begin(folder)
        outcome = "not begun"
    assert files(folder) == whole
    list(resume(folder))  # it is finished
    assert files(folder) == whole
    return outcome


@pytest.mark.parametrize("of", ["a run", "a resumed run", "a run that replaces another"])
def test_a_power_cut_after_every_step(
    of: str, tmp_path: Path, nursery: ModuleType, pictures: dict[str, Path]
) -> None:
    def begin(folder: Path) -> None:
        nursery.begin(pictures["new"], folder, EVERY_S, video=True)

    def go_on(folder: Path) -> None:
        nursery.go_on(folder, EVERY_S)

    begin(tmp_path / "whole")
    whole, old, run = files(tmp_path / "whole"), {}, tmp_path / "run"
    work = begin
    run.mkdir()
    if of == "a resumed run":
        work = go_on
        broken = Tape(run)
        with pytest.MonkeyPatch.context() as patch:
            broken.install(patch)
            begin(run)
        shutil.rmtree(run)
        build(broken.after(2 * len(broken.steps) // 3), run, everything, everything)
    if of == "a run that replaces another":
        nursery.begin(pictures["old"], run, EVERY_S, video=True)
        old = files(run)
    tape = Tape(run)
    with pytest.MonkeyPatch.context() as patch:
        tape.install(patch)
        work(run)
    assert files(run) == whole

    def check(folder: Path) -> str:
        if old:
            # Until the new run counts, the earlier one is there, finished as it was.
            go_on(folder)
            if files(folder) == old:
                return "as before"
        return recovered(folder, go_on, begin, whole)

    (tmp_path / "cuts").mkdir()
    outcomes = every_cut(tape, tmp_path / "cuts", check)
    print(f"{of}: {len(tape.steps)} steps, {dict(outcomes)}")
    assert len(tape.steps) > 30 and outcomes["resumed"] > 100
    assert (outcomes["not begun"] > 0) == (of == "a run") and (outcomes["as before"] > 0) == bool(old)

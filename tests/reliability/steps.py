"""The steps by which a run changes its disk, counted, and what stands in for a process that dies at one."""

from __future__ import annotations

import io
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import Any

import pytest

from bayesnet_track.journal import disk

CHANGES = ("sync", "sync_folder", "replace", "unlink", "make_folder", "remove_folder")
"""Of `disk`, beside what its open files do."""


def restored(patch: pytest.MonkeyPatch) -> None:
    """What is installed from here on is gone when `patch` is undone."""
    for name in (*CHANGES, "open_raw"):
        patch.setattr(disk, name, getattr(disk, name))


class Counted:
    """Calls of the system by which files change, counted; at call `at`, `act` is called instead."""

    def __init__(self, at: int, act: Callable[[], None]) -> None:
        self.calls, self._at, self._act = 0, at, act

    def one(self, half: Callable[[], Any] | None = None) -> None:
        self.calls += 1
        if self.calls == self._at:
            if half is not None:
                half()
            self._act()

    def install(self) -> None:
        counted = self

        class File(io.FileIO):
            def write(self, data: Any) -> int:
                whole = bytes(data)
                counted.one(lambda: io.FileIO.write(self, whole[: len(whole) // 2]))
                return io.FileIO.write(self, whole) or 0

            def truncate(self, size: int | None = None) -> int:
                counted.one()
                return io.FileIO.truncate(self, size)

        def before(call: Callable[..., Any]) -> Callable[..., Any]:
            def wrapped(*arguments: Any) -> Any:
                counted.one()
                return call(*arguments)

            return wrapped

        for name in CHANGES:
            setattr(disk, name, before(getattr(disk, name)))
        disk.open_raw = lambda path, mode: File(str(path), mode.replace("b", ""))


class Killed(BaseException):
    """In place of kill -9 inside one process; nothing that handles errors takes it for one."""


class Life(Counted):
    """A process that is killed in the middle of its step number `at`; from there on it changes nothing.

    Attributes:
        is_dead: whether it was killed.
        commits: names that its renames gave to files and folders.
    """

    def __init__(self, at: int) -> None:
        super().__init__(at, self._die)
        self.is_dead = False
        self.commits: list[str] = []

    def one(self, half: Callable[[], Any] | None = None) -> None:
        self._check()
        super().one(half)

    def install(self) -> None:
        rename = disk.replace

        def noted(source: Path, target: Path) -> None:
            rename(source, target)
            self.commits.append(target.name)

        disk.replace = noted
        super().install()
        opened = disk.open_raw

        def open_alive(path: Path, mode: str) -> FileIO:
            self._check()  # to open a file for writing empties it
            return opened(path, mode)

        disk.open_raw = open_alive

    def _die(self) -> None:
        self.is_dead = True
        raise Killed

    def _check(self) -> None:
        if self.is_dead:
            raise Killed

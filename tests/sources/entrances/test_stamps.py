"""Stamps: which files changed since, told without reading them."""

from __future__ import annotations

import os
from pathlib import Path

from bayesnet_track.sources.origin import changed_since, stamps


def test_contents_of_the_same_length_replacements_and_growth_are_changes(tmp_path: Path) -> None:
    names = ("same", "replaced", "grown", "untouched", "removed")
    paths = {name: tmp_path / name for name in names}
    for path in paths.values():
        path.write_bytes(b"abc")
        os.utime(path, ns=(10**18, 10**18))
    before = stamps([*paths.values(), tmp_path / "absent"])
    assert tmp_path / "absent" not in before
    paths["same"].write_bytes(b"abd")
    paths["grown"].write_bytes(b"abcd")
    os.utime(paths["grown"], ns=(10**18, 10**18))
    paths["removed"].unlink()
    (tmp_path / "copy").write_bytes(b"abc")
    os.utime(tmp_path / "copy", ns=(10**18, 10**18))
    (tmp_path / "copy").replace(paths["replaced"])
    paths["untouched"].read_bytes()
    assert {path.name for path in changed_since(before)} == {"same", "replaced", "grown"}

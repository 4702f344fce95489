"""Files from outside: found where they were, or as given, and compared by what they hold."""

import hashlib

import pytest

from bayesnet_track.runtime.checkpoints.origins import file_sha256
from bayesnet_track.runtime.checkpoints.recipe import given_file


def test_a_file_is_as_it_was_until_its_bytes_change(tmp_path):
    path = tmp_path / "one.csv"
    path.write_bytes(b"frame,range\n")
    given = given_file(path)
    assert given.sha256 == file_sha256(path) == hashlib.sha256(b"frame,range\n").hexdigest()
    assert given.changes() == ()
    path.write_bytes(b"frame,bearing\n")
    (said,) = given.changes()
    assert said.startswith(f"{path}: {given.sha256[:12]}, now ")


def test_a_file_that_moved_with_the_working_directory_is_found(tmp_path, monkeypatch):
    (tmp_path / "then").mkdir()
    (tmp_path / "then/one.csv").write_bytes(b"1")
    monkeypatch.chdir(tmp_path / "then")
    given = given_file("one.csv")
    (tmp_path / "then").rename(tmp_path / "now")
    monkeypatch.chdir(tmp_path / "now")
    assert given.changes() == ()
    (tmp_path / "now/one.csv").unlink()
    with pytest.raises(OSError, match="not a plain file"):
        given.changes()

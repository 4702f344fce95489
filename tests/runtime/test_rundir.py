"""Run directories: made new, refused where something else is, emptied only when asked."""

import pytest

from bayesnet_track.runtime.recording.manifest import is_locked, lock_run
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory, RunDirectoryError


def test_a_new_folder_is_made_with_its_parents(tmp_path):
    run = RunDirectory.create(tmp_path / "a" / "b")
    assert run.path.is_dir()
    assert list(run.path.iterdir()) == []


def test_names_are_the_documented_ones(tmp_path):
    run = RunDirectory(tmp_path)
    names = {name: getattr(run, name).name for name in FILES}
    assert names == FILES
    assert run.journal == tmp_path / "journal.jsonl"


def test_an_empty_folder_is_taken(tmp_path):
    assert RunDirectory.create(tmp_path).path == tmp_path


def test_a_folder_with_other_things_is_refused_even_to_overwrite(tmp_path):
    (tmp_path / "thesis.txt").write_text("x")
    for overwrite in (False, True):
        with pytest.raises(RunDirectoryError, match="not empty and not a run"):
            RunDirectory.create(tmp_path, overwrite)
    assert (tmp_path / "thesis.txt").read_text() == "x"


def old_run(folder):
    for name in FILES.values():
        (folder / name).write_text("old")
    (folder / "notes.txt").write_text("mine")


def test_an_earlier_run_is_refused_and_untouched(tmp_path):
    old_run(tmp_path)
    with pytest.raises(RunDirectoryError, match="a run is there already"):
        RunDirectory.create(tmp_path)
    assert {(tmp_path / name).read_text() for name in FILES.values()} == {"old"}


def test_clearing_removes_the_run_and_nothing_else(tmp_path):
    old_run(tmp_path)
    run = RunDirectory.create(tmp_path, overwrite=True)
    assert {(tmp_path / name).read_text() for name in FILES.values()} == {"old"}
    with lock_run(run):
        run.clear()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [".lock", "notes.txt"]


def test_a_lock_file_alone_is_an_empty_folder(tmp_path):
    with lock_run(RunDirectory.create(tmp_path)):
        pass
    assert (tmp_path / ".lock").read_bytes() == b""
    assert RunDirectory.create(tmp_path).path == tmp_path


def test_one_lock_at_a_time_before_there_is_a_run_and_after_it_was_cleared(tmp_path):
    run = RunDirectory.create(tmp_path / "run")
    for _ in range(2):
        with lock_run(run):
            assert is_locked(run)
            with pytest.raises(RunDirectoryError, match="another process is writing this run"), lock_run(run):
                pytest.fail("two at once")
            run.write_text(run.journal, "x")
            run.clear()
            with pytest.raises(RunDirectoryError, match="another process"), lock_run(run):
                pytest.fail("two at once")
        assert not is_locked(run)


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "run").write_text("x")
    with pytest.raises(RunDirectoryError, match="it is a file"):
        RunDirectory.create(tmp_path / "run")
    with pytest.raises(RunDirectoryError, match="cannot make the run directory: Not a directory"):
        RunDirectory.create(tmp_path / "run" / "below")


def test_a_folder_without_permission_is_a_clear_error(tmp_path, monkeypatch):
    def denied(path, *_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("os.open", denied)
    run = RunDirectory.create(tmp_path / "run")
    with (
        pytest.raises(RunDirectoryError, match="cannot make the run directory: Permission denied"),
        lock_run(run),
    ):
        pytest.fail("it cannot be locked")


def test_text_is_utf8_with_plain_newlines(tmp_path):
    run = RunDirectory.create(tmp_path / "run")
    run.write_text(run.graph, "name: größe\n")
    assert run.graph.read_bytes() == "name: größe\n".encode()


def test_a_text_that_cannot_be_written_is_a_clear_error(tmp_path):
    run = RunDirectory(tmp_path / "none")
    with pytest.raises(RunDirectoryError, match=r"graph\.yaml: cannot write: No such file"):
        run.write_text(run.graph, "x")


def test_opening_wants_a_journal(tmp_path):
    with pytest.raises(RunDirectoryError, match="no such folder"):
        RunDirectory.open(tmp_path / "none")
    with pytest.raises(RunDirectoryError, match=r"no journal\.jsonl in it"):
        RunDirectory.open(tmp_path)
    (tmp_path / "journal.jsonl").write_text("")
    assert RunDirectory.open(str(tmp_path)).path == tmp_path


def test_a_folder_of_runs_names_them(tmp_path):
    for name in ("car", "girl"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "journal.jsonl").touch()
    with pytest.raises(RunDirectoryError, match=r"no journal.jsonl in it; runs in .*: car, girl$"):
        RunDirectory.open(tmp_path)

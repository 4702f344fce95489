"""Workers that cannot be started: the run ends with the reason, it does not go on without its agents."""

from __future__ import annotations

import errno
import os

import pytest

from bayesnet_track import track
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.executors import PlacingError
from bayesnet_track.runtime.executors.workers import ForkServer
from bayesnet_track.sources.scenes.library import SceneSource


@pytest.mark.slow
@pytest.mark.parametrize("started", [0, 1])
def test_a_worker_that_cannot_start_is_no_agent_without_answer(monkeypatch, tmp_path, started):
    start, left = ForkServer.worker, [started]

    def worker(self):
        if not left[0]:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        left[0] -= 1
        return start(self)

    monkeypatch.setattr(ForkServer, "worker", worker)
    scene = SceneSource.named("two_squares", 0, 4)
    with pytest.raises(PlacingError, match=r"Too many open files.*ulimit -n.*executor='serial'"):
        list(
            track(
                "two_squares",
                scene,
                scene.scene.start_box,
                executor="processes",
                workers=2,
                out=tmp_path / "run",
            )
        )
    assert not (tmp_path / "run" / "manifest.json").exists(), "the run is not complete"


def test_nor_is_one_for_which_nothing_can_be_forked(monkeypatch, tmp_path, capsys):
    def start(self):
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(ForkServer, "_start", start)
    assert main(["demo", "two_squares", "--executor", "processes", "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert "no worker process can be started (Resource temporarily unavailable)" in error
    assert "Traceback" not in error

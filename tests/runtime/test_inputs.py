"""What comes from outside is written down, and given again it gives the same bytes."""

from __future__ import annotations

import pytest

from bayesnet_track import open_run, track
from bayesnet_track.journal.events.load import InputRefused, Released, Toggled
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.net import replay
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.runtime.results import Switchboard
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "inputs.jsonl")


def written(path):
    return {name: (path / name).read_bytes() for name in FILES if (path / name).exists()}


def play(out, inputs, frames=12):
    scene = make_scene("two_squares", seed=3)
    return list(
        track("two_squares", SceneSource(scene, "scene", frames), scene.start_box, out=out, inputs=inputs)
    )


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A run in which a person switches agents in frame 3, releases one in 8, and asks for the impossible."""
    board, out = Switchboard(), tmp_path_factory.mktemp("live") / "run"

    def asked(frame):
        if frame == 3:
            board.switch("1", "motion", on=True)
            board.switch("1", "color", on=False)
            board.switch("2", "motion", on=True)
        if frame == 8:
            board.release("1", "color")
        return board(frame)

    return play(out, asked), out


def test_a_person_switches_and_the_journal_tells(live):
    results, out = live
    asked = [Toggled(3, "1", "motion", True), Toggled(3, "1", "color", False)]
    assert [d for d in results[3].decisions if isinstance(d, Toggled)] == asked
    assert "motion" in results[4].targets[0].active and "color" not in results[4].targets[0].active
    events = open_run(out).events
    assert InputRefused(3, "2", "motion", "there is no target 2") in events
    # It stays as it was set: no rule switches either while they are held.
    switched = [e for e in events if isinstance(e, Activated | Deactivated) and 3 <= e.frame < 8]
    assert not {"motion", "color"} & {e.node for e in switched}


def test_the_inputs_are_written_down_as_they_were_given(live):
    _, out = live
    assert list(read_inputs(out / "inputs.jsonl")) == [
        Toggled(3, "1", "motion", True),
        Toggled(3, "1", "color", False),
        Toggled(3, "2", "motion", True),
        Released(8, "1", "color"),
    ]


def test_given_again_they_give_the_same_bytes(live, tmp_path):
    _, out = live
    play(tmp_path / "again", out / "inputs.jsonl")
    assert written(tmp_path / "again") == written(out)
    assert set(written(out)) == set(FILES)


def test_without_anything_from_outside_there_is_no_file(tmp_path):
    play(tmp_path / "run", None, 3)
    assert not (tmp_path / "run" / "inputs.jsonl").exists()


def test_the_journal_rebuilds_what_a_person_holds(live):
    _, out = live
    from bayesnet_track.journal.net import Decision

    decisions = [e for e in open_run(out).events if isinstance(e, Decision)]
    assert replay(decisions, 3).targets["1"].by_hand == {}
    assert replay(decisions, 4).targets["1"].by_hand == {"motion": True, "color": False}
    assert replay(decisions, 9).targets["1"].by_hand == {"motion": True}

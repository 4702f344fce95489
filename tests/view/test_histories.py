"""What charts draw of a target: its frames, its agents, and the stretches in which something held."""

from dataclasses import replace

import numpy as np

from bayesnet_track.view.page_data import histories


def test_each_target_has_its_own_frames_and_agents(metrics):
    lines = [
        replace(metrics, frame=frame, target=target, ud_px2=float(frame), active=active, status=status)
        for frame, target, active, status in [
            (0, "a", ("x",), "tracking"),
            (1, "a", ("x", "y"), "lost"),
            (1, "b", ("z",), "tracking"),
            (4, "a", ("y",), "lost"),
        ]
    ]
    both = histories(lines, ["b", "a", "none"])
    a, b = both["a"], both["b"]
    assert a.frame.tolist() == [0, 1, 4] and a.ud_px2.tolist() == [0.0, 1.0, 4.0]
    assert a.agents == ("x", "y") and b.agents == ("z",)
    assert a.is_active("y").tolist() == [False, True, True]
    assert a.stretches(a.is_lost) == [(1, 4)]
    assert len(both["none"]) == 0 and both["none"].agents == ()


def test_stretches_end_where_a_row_is_not_wanted(metrics):
    lines = [replace(metrics, frame=frame, target="1") for frame in (0, 1, 2, 5, 6, 7)]
    history = histories(lines, ["1"])["1"]
    assert history.stretches(np.isin(history.frame, [1, 2, 5, 7])) == [(1, 5), (7, 7)]
    assert history.stretches(np.isin(history.frame, [0])) == [(0, 0)]
    assert history.stretches(np.isin(history.frame, [9])) == []

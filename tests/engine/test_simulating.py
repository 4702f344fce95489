"""Draws from the prior have its distribution: against the closed form of a linear-Gaussian graph."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.engine.simulating import Simulation, simulate
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph

GRAPH = """\
bayesnet: 1
name: prior
targets:
  ball:
    nodes:
      ball:
        belief: {gaussian: {filter: kalman}}
        motion: MOTION
        estimate: mean
        MODES
      place: {parent: ball, agent: mean_shift}
"""
VELOCITY = "{constant_velocity: {sd_velocity_px: 0.7, start_velocity_sd_px: 2, sd_px: {x: 1, y: 1}}}"
BOX = np.array([500.0, 400.0, 40.0, 30.0])


def plate(motion, modes=""):
    graph = check(*read_graph(GRAPH.replace("MOTION", motion).replace("MODES", modes), "prior.yaml"))
    return graph.targets["ball"]


def test_constant_velocity_is_drawn_from_its_gaussian():
    draws, frames = 2000, 12
    drawn = simulate(plate(VELOCITY), {}, BOX, Simulation(frames, draws, 3, (1000, 800)))
    move = np.array([[1.0, 1.0], [0.0, 1.0]])
    noise = 0.7**2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]) + np.diag([1.0, 0.0])
    covariance = np.diag([0.0, 4.0])
    for frame in range(1, frames + 1):
        covariance = move @ covariance @ move.T + noise
        for axis in (0, 1):
            state = drawn.states[frame][:, [axis, 4 + axis]] - np.array([BOX[axis], 0.0])
            # Squared distances of Gaussians in two dimensions are exponential; five sds of their mean.
            d2 = np.einsum("nk,nk->n", state, np.linalg.solve(covariance, state.T).T)
            assert abs(d2.mean() / 2 - 1) < 5 / np.sqrt(draws)
            assert stats.kstest(state[:, 0] / np.sqrt(covariance[0, 0]), "norm").pvalue > 1e-4
    np.testing.assert_array_equal(drawn.boxes[:, :, 2:], np.broadcast_to(BOX[2:], (frames + 1, draws, 2)))


def test_one_seed_gives_the_same_and_another_does_not():
    chosen = [Simulation(3, 5, seed, (1000, 800)) for seed in (1, 1, 2)]
    first, same, other = (simulate(plate(VELOCITY), {}, BOX, one).states for one in chosen)
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


def test_modes_are_drawn_from_their_chain():
    turn = "{motion: {random_walk: {sd_px: {x: 9}}}, next: {still: 0.5, turn: 0.5}}"
    modes = f"modes: {{still: {{next: {{still: 0.9, turn: 0.1}}}}, turn: {turn}}}"
    draws = 2000
    drawn = simulate(plate(VELOCITY, modes), {}, BOX, Simulation(6, draws, 0, (1000, 800)))
    assert drawn.modes == ("still", "turn") and drawn.fields[-1] == "mode"
    turns = drawn.states[:, :, -1].mean(axis=1)
    np.testing.assert_allclose(turns, 1 / 6, atol=5 * np.sqrt(5 / 36 / draws))  # the chain's long run
    after = drawn.states[1:, :, -1][drawn.states[:-1, :, -1] == 1]
    assert abs(after.mean() - 0.5) < 5 * 0.5 / np.sqrt(len(after))


def test_trajectories_stay_on_the_image_as_hypotheses_do():
    drawn = simulate(plate(VELOCITY), {}, BOX, Simulation(60, 50, 0, (520, 420)))
    assert drawn.boxes[..., 0].max() == 519 and drawn.boxes[..., 0].min() >= 0


def test_the_size_reverts_where_the_graph_says_so():
    walk = "{random_walk: {sd_log: {scale: 0.05}, size_reversion: {sd_scale: 0.1}}}"
    graph = GRAPH.replace("{gaussian: {filter: kalman}}", "particles").replace("mean_shift", "intensity")
    text = graph.replace("MOTION", walk).replace("MODES", "")
    ball = check(*read_graph(text, "prior.yaml")).targets["ball"]
    drawn = simulate(ball, {}, BOX, Simulation(80, 800, 0, (1000, 800)))
    side = np.log(drawn.boxes[-1, :, 2] * drawn.boxes[-1, :, 3] / (BOX[2] * BOX[3])) / 2
    assert abs(side.std() / 0.1 - 1) < 5 / np.sqrt(2 * 800)


def test_nothing_to_draw_is_refused():
    with pytest.raises(ValueError, match="at least 1 of each"):
        simulate(plate(VELOCITY), {}, BOX, Simulation(0, 5))

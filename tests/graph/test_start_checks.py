"""Wrong uses of start priors, with what is said of each, word for word."""

from __future__ import annotations

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.text.messages import GraphError

HEAD = "bayesnet: 1\nname: m\nconstants: {far: 30}\ntargets:\n  a:\n    nodes:\n"
BELOW = "      c: {parent: a, agent: color_histogram}\n"
CV, WALK = "motion: {constant_velocity: {}}", "motion: {random_walk: {sd_px: {x: 2, y: 2}}}"
FORMULA = "motion: {expressions: {fields: {z: {sd: 1}}, sd: {x: 1, z: 1}}}"
GAUSSIAN = "belief: {gaussian: {filter: extended}}"
WRONG = {
    "a field that is not there": (
        f'{WALK}, start: {{vx: "normal(0, 3)"}}',
        "start of 'vx', which is no field of the state; allowed: x, y, w, h",
    ),
    "the angle": (
        "motion: {random_walk: {sd_px: {x: 2}, sd_angle_deg: 3}}, start: {angle: 4}",
        "start of angle, which is that of the first frame: 0; allowed: x, y, w, h",
    ),
    "an unknown name": (
        f'{CV}, start: {{x: "normal(x, fa)"}}',
        "unknown name 'fa'; allowed: x, y, w, h, pi, far; nearest: far",
    ),
    "a field in place of the box": (
        f'{CV}, start: {{vx: "normal(vx, 1)"}}',
        "'vx', which is no part of the start box; allowed: x, y, w, h, pi, far",
    ),
    "the value as in a factor": (
        f'{CV}, start: {{x: "normal(x, 0, 3)"}}',
        "normal with 3 arguments; allowed: normal(mean, sd)",
    ),
    "an sd of 0": (
        f'{CV}, start: {{vx: "normal(0, 0)"}}',
        "normal that does not exist: 0, 0; allowed: sds, scales and degrees above 0, low below high",
    ),
    "no variance": (
        f'{GAUSSIAN}, {CV}, start: {{vx: "student_t(0, 1, 2)"}}',
        "belief: gaussian, and student_t of vx has no variance; allowed: more than 2 degrees, or belief: pa",
    ),
    "said twice": (
        f'{FORMULA}, start: {{z: "uniform(0, 1)"}}',
        "start of z beside fields.z, which says it, too; allowed: either of them",
    ),
    "an sd of the velocity beside it": (
        'motion: {constant_velocity: {start_velocity_sd_px: 2}}, start: {vx: "normal(0, 1)"}',
        "start of vx beside start_velocity_sd_px, which says it, too; allowed: either of them",
    ),
    "in a mode": (
        f"{CV}, modes: {{s: {{mean_frames: 9}}, t: {{mean_frames: 9, motion: {{constant_velocity: "
        "{sd_velocity_px: 5, start_sd_px: {x: 3}}}}}",
        "start_sd_px in a mode: a target starts in no certain mode; allowed: start: {x: normal(x, 5)} of a",
    ),
    "beside a grid": (
        f'belief: {{grid: {{}}}}, {CV}, start: {{x: "normal(x, 5)"}}',
        "a start prior beside a grid, which starts in the cell of the start box; allowed: particles or gauss",
    ),
    "a mean of the box": (
        "motion: {expressions: {fields: {x: {start: 9, sd: 1}}, sd: {x: 1}}}",
        "start of x, which is that of the start box; allowed: an sd alone; or start: {x: normal(x + 10, 5)}",
    ),
    "cut at a comma": (
        f"{CV}, start: {{x: normal(x, 5)}}",
        "x is cut at a comma; allowed: quotes around the expression",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_start_prior_is_refused_with_what_to_do(name, tmp_path):
    root, said = WRONG[name]
    path = tmp_path / "wrong.yaml"
    path.write_text(f"{HEAD}      a: {{{root}}}\n{BELOW}", encoding="utf-8")
    with pytest.raises(GraphError) as error:
        load_graph(str(path))
    assert said in str(error.value)
    assert "wrong.yaml:7:" in str(error.value)


def test_below_the_root_nothing_starts_by_itself(tmp_path):
    path = tmp_path / "wrong.yaml"
    middle = "      b: {parent: a, fuse: product, start: {x: 3}}\n" + BELOW.replace("parent: a", "parent: b")
    path.write_text(f"{HEAD}      a: {{{CV}}}\n{middle}", encoding="utf-8")
    with pytest.raises(GraphError, match="key 'start' below the root; allowed: only at the root, a"):
        load_graph(str(path))

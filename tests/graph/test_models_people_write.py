"""State-space models as people write them: each runs, or is refused with a sentence that says what to do."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.graph.text.explain import describe_error
from bayesnet_track.graph.text.messages import GraphError

RADIO = "{readings: {file: FILE, sd: {x: 2, y: 2}}}"
HEAD = "bayesnet: 1\nname: m\n"
ONE = HEAD + "targets:\n  a:\n    nodes:\n"


def model(root, *nodes, head=ONE):
    """A target `a`, its root and further nodes, a line each."""
    return head + "".join(f"      {line}\n" for line in (f"a: {root}", *nodes))


SEEN = f"s: {{parent: a, agent: {RADIO}}}"
COLOUR = "c: {parent: a, agent: color_histogram}"
CV = "motion: {constant_velocity: {}}"
MOVES = f"{{{CV}}}"
RUNS = {
    "unknown noise": model(
        "{belief: {particles: {size: 300}}, motion: {expressions: {fields: {logq: {start: 1, sd: 1}}, "
        "sd: {x: exp(logq), y: exp(logq)}, static_discount: 0.98}}}",
        SEEN,
    ),
    "a turn as a mode": model(
        "{belief: {gaussian: {filter: extended, gate: 1}}, "
        "motion: {constant_velocity: {sd_velocity_px: 0.3}}, "
        "modes: {straight: {mean_frames: 40}, turn: {mean_frames: 10, motion: {expressions: "
        "{fields: {vx: {sd: 5}, vy: {sd: 5}, rate: {sd: 0.3}}, drift: {x: x + vx * dt, y: y + vy * dt, "
        "vx: vx * cos(rate * dt) - vy * sin(rate * dt), vy: vx * sin(rate * dt) + vy * cos(rate * dt)}, "
        "sd: {vx: 0.3, vy: 0.3, rate: 0.02}}}}}}",
        SEEN,
    ),
    "a sensor whose readings come late": model(
        f"{{belief: {{gaussian: {{filter: extended}}}}, {CV}, fuse: product}}",
        SEEN,
        "l: {parent: a, agent: {readings: {file: FILE, sd: {u: 2}, delay: 2}}, measures: {u: x}}",
    ),
    "a team as a category": model(
        f"{{belief: {{particles: {{size: 300}}}}, {CV}, category: {{team: {{values: [red, blue]}}}}}}",
        COLOUR,
        'f: {parent: a, factor: "where(team == red, normal(x, 60, 40), normal(x, 100, 40))"}',
    ),
    "a second camera by its homography": model(
        f"{{belief: {{gaussian: {{filter: unscented}}}}, {CV}, fuse: product}}",
        SEEN,
        "t: {parent: a, agent: {readings: {file: FILE, sd: {u: 2}}}, "
        'measures: {u: "(0.9 * x + 0.1 * y + 4) / (1 + 0.001 * x)"}}',
    ),
    "an unknown gain": model(
        "{belief: {gaussian: {filter: extended}}, motion: {expressions: {fields: {vx: {sd: 3}, vy: {sd: 3}, "
        "g: {start: 0.1, sd: 0.1}}, drift: {x: x + vx * dt, y: y + vy * dt, vy: vy + g * dt}, "
        "sd: {x: 0.3, y: 0.3, vx: 0.1, vy: 0.1}}}, estimate: mean}",
        SEEN,
    ),
    "a factor that reads the mode": model(
        f"{{belief: {{particles: {{size: 300}}}}, {CV}, modes: {{walk: {{mean_frames: 50}}, run: "
        "{mean_frames: 50, motion: {constant_velocity: {sd_velocity_px: 5}}}}}",
        COLOUR,
        'f: {parent: a, factor: "where(mode == run, 1, 0.5)"}',
    ),
    "a constant delay by augmentation": model(
        "{belief: {gaussian: {filter: extended}}, motion: {expressions: {fields: {vx: {sd: 5}, vy: {sd: 5}, "
        "x1: {start: 60}, y1: {start: 60}}, drift: {x: x + vx * dt, y: y + vy * dt, x1: x, y1: y}, "
        "sd: {vx: 1, vy: 1}}}}",
        "l: {parent: a, agent: {readings: {file: FILE, sd: {u: 2}}}, measures: {u: x1}}",
    ),
    "heavy tails of the motion": model(
        "{belief: {particles: {size: 300}}, motion: {random_walk: {sd_px: {x: 3, y: 3}, "
        "heavy_tail: {weight: 0.1, factor: 8}}}}",
        SEEN,
    ),
    "depth as a field": model(
        "{belief: {particles: {size: 300}}, motion: {expressions: {fields: {z: {start: 5, sd: 1}}, "
        'drift: {z: "max(z, 0.1)"}, sd: {x: 2, y: 2, z: 0.1}}}, fuse: product}',
        COLOUR,
        'f: {parent: a, factor: "lognormal(h * z, 5, 0.3)"}',
    ),
    "a start prior of the place": model(
        "{motion: {expressions: {fields: {x: {sd: 5}}, sd: {x: 2, y: 2}}}}", COLOUR
    ),
    "a start prior of a walk": model(
        "{motion: {random_walk: {sd_px: {x: 2, y: 2}, start_sd_px: {x: 20, y: 20}}}}", COLOUR
    ),
    "noise of a measurement that is a field": model(
        "{belief: {particles: {size: 300}}, motion: {expressions: {fields: {r: {start: 1, sd: 1}}, "
        "sd: {x: 3, y: 3}, static_discount: 0.98}}}",
        "s: {parent: a, agent: {readings: {file: FILE, sd: {x: exp(r), y: 2}}}}",
    ),
    "heavy tails of a measurement": model(
        MOVES, 's: {parent: a, agent: {readings: {file: FILE, sd: {x: "student_t(2, 3)", y: 2}}}}'
    ),
    "a prior of a constant as a field": model(
        "{belief: {particles: {size: 300}}, motion: {expressions: {fields: {q: {}}, sd: {x: q, y: 2}, "
        'static_discount: 0.98}}, start: {q: "lognormal(0, 1)"}}',
        SEEN,
    ),
    "an input and the time": HEAD
    + "inputs: {pan: {file: FILE, column: x}}\n"
    + model(
        "{motion: {expressions: {drift: {x: x + pan - pan_before + 0.1 * t}, sd: {x: 2, y: 2}}}}",
        COLOUR,
        head=ONE.removeprefix(HEAD),
    ),
    "a formation": HEAD
    + "joins: [{between: [a, a], factor: 'normal(hypot(a.x - b.x, a.y - b.y), 50, 5)', when: {overlap: 0}}]\n"
    + model(f"{{belief: {{particles: {{size: 300}}}}, {CV}}}", COLOUR, head=ONE.removeprefix(HEAD)),
    "a spring": HEAD
    + "joins: [{between: [a, b], factor: 'normal(a.x - b.x, 40, 5)', when: {overlap: 0}}]\n"
    + model(f"{{belief: {{particles: {{size: 300}}}}, {CV}}}", COLOUR, head=ONE.removeprefix(HEAD))
    + f"  b:\n    nodes:\n      b: {{belief: {{particles: {{size: 300}}}}, {CV}}}\n"
    + "      k: {parent: b, agent: color_histogram}\n",
}
ARM = (
    "{belief: {particles: {size: 300}}, motion: {expressions: {fields: {shoulder: {sd: 1}, elbow: {sd: 1}}, "
    "sd: {x: 2, y: 2, shoulder: 0.1, elbow: 0.1}}}, fuse: product}"
)
HAND = (
    'x: "normal(parent.x + 9 * cos(parent.shoulder) + 9 * cos(parent.shoulder + parent.elbow), 2)", '
    'y: "normal(parent.y + 9 * sin(parent.shoulder), 2)"'
)
RUNS["an arm with angles of its own"] = model(
    ARM,
    COLOUR,
    f"h: {{parent: a, fuse: {{latent: {{given: {{{HAND}}}}}}}}}",
    "t: {parent: h, agent: intensity}",
)
REFUSED = {
    "a source of an agent's own": (
        model(
            f"{{belief: {{gaussian: {{filter: unscented}}}}, {CV}, fuse: product}}",
            COLOUR,
            "t: {parent: a, agent: {color_histogram: {source: two.mp4}}, measures: {u: 0.9 * x, v: y}}",
        ),
        (
            "unknown key 'source'",
            "{color_histogram: {source: two.mp4}}",
            "{readings: {file: FILE, sd: {u: 3}}}",
        ),
        ("measures of 'v', which the agent does not measure; allowed: u", ", v: y", ""),
    ),
    "a point that is looked at": (
        HEAD + f"targets:\n  a:\n    state: point\n    nodes:\n      a: {MOVES}\n      {COLOUR}\n",
        ("leave out `state: point`", "    state: point\n", ""),
    ),
    "a team as two modes": (
        model(
            f"{{belief: {{particles: {{}}}}, {CV}, "
            "modes: {red: {mean_frames: 9e4}, blue: {mean_frames: 9e4}}}",
            COLOUR,
        ),
        (
            "category: {team: {values: [red, blue]}} at the root",
            "modes: {red: {mean_frames: 9e4}, blue: {mean_frames: 9e4}}",
            "category: {team: {values: [red, blue]}}",
        ),
        (
            "of which nothing says anything; allowed: agent: {detection: {confusion:",
            COLOUR,
            f"{COLOUR}\n      f: {{parent: a, factor: 'where(team == red, normal(x, 60, 9), 0.01)'}}",
        ),
    ),
    "a query of a target": (
        HEAD
        + "targets:\n  a:\n    queries: {goal: x > 300}\n    nodes:\n"
        + f"      a: {MOVES}\n      {COLOUR}\n",
        (
            "`queries` stands beside `targets:`",
            "targets:\n  a:\n    queries: {goal: x > 300}\n",
            "queries: {goal: x > 300}\ntargets:\n  a:\n",
        ),
        (
            "write goal: {of: .., probability: x > 300}",
            "goal: x > 300",
            "goal: {of: a, probability: x > 300}",
        ),
    ),
    "a prior of a constant": (
        HEAD
        + 'constants: {q: "lognormal(0, 1)"}\n'
        + model("{motion: {random_walk: {sd_px: {x: q, y: 2}}}}", COLOUR, head=ONE.removeprefix(HEAD)),
        (
            "motion: {expressions: {fields: {q: {}}, sd: {x: q, ..}}}, with a start prior beside the motion,",
            "motion: {random_walk: {sd_px: {x: q, y: 2}}}",
            'motion: {expressions: {fields: {q: {}}, sd: {x: q, y: 2}}}, start: {q: "lognormal(0, 1)"}',
        ),
        ("q is 'lognormal(0, 1)'; allowed: a number", 'constants: {q: "lognormal(0, 1)"}\n', ""),
    ),
    "a confusion matrix of a detector": (
        HEAD
        + "targets:\n  a:\n    birth: {detector: {detections: {confusion: {red: {red: 0.9}}}}}\n    nodes:\n"
        + f"      a: {{belief: {{gaussian: {{}}}}, {CV}}}\n      s: {{parent: a, agent: detection}}\n",
        (
            "is of the agent: agent: {detection: {confusion: {team: {red: {red: 0.9, blue: 0.1}, ..}}}}",
            "agent: detection",
            "agent: {detection: {confusion: {team: {red: {red: 0.9, blue: 0.1}}}}}",
        ),
        ("unknown key 'confusion'", "{detections: {confusion: {red: {red: 0.9}}}}", "detections"),
        (
            "confusion",
            f"{CV}}}",
            f"{CV}, category: {{team: {{values: [red, blue]}}}}}}",
        ),
        (
            "confusion of team without blue; allowed: a row for each value",
            "blue: 0.1}",
            "blue: 0.1}, blue: {red: 0.1, blue: 0.9}",
        ),
    ),
    "an input": (
        model("{motion: {expressions: {drift: {x: x + pan * dt}, sd: {x: 2, y: 2}}}}", COLOUR),
        ("inputs: {pan: {file: FILE.csv}}", "targets:", "inputs: {pan: {file: FILE}}\ntargets:"),
        ("no column 'pan'; there are frame, x, y, u", "{file: FILE}", "{file: FILE, column: u}"),
    ),
    "the time": (
        model("{motion: {expressions: {drift: {x: x + frame * dt}, sd: {x: 2, y: 2}}}}", COLOUR),
        ("t is the time in frame intervals", "frame * dt", "t * dt"),
    ),
    "a factor of three": (
        HEAD
        + "joins: [{between: [a, a, a], factor: 'normal(a.x - b.x, 4, 5)', when: {overlap: 0}}]\n"
        + model(MOVES, COLOUR, head=ONE.removeprefix(HEAD)),
        ("between: [a, a] relates every pair of them", "[a, a, a]", "[a, a]"),
    ),
}


def with_readings(text, folder):
    """The model with its file of readings."""
    file = folder / "radio.csv"
    file.write_text("frame,x,y,u\n1,61,60,61\n2,62,60,62\n3,63,61,63\n", encoding="utf-8")
    path = folder / "model.yaml"
    path.write_text(text.replace("FILE", str(file)), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("images"), np.random.default_rng(0)
    for number in range(4):
        assert cv2.imwrite(str(folder / f"{number}.png"), rng.integers(0, 255, (120, 160, 3), np.uint8))
    return str(folder)


@pytest.mark.parametrize("name", RUNS)
def test_a_model_runs(name, tmp_path, images):
    graph = load_graph(with_readings(RUNS[name], tmp_path))
    kinds = [*graph.targets] * (2 if name == "a formation" else 1)
    starts = [Start((50 + 20 * k, 50, 20, 20), kind) for k, kind in enumerate(kinds)]
    results = list(track(graph, images, starts, seed=2))
    assert len(results) == 4 and len(results[-1].targets) == len(starts)
    assert all(np.isfinite(line.centre_box).all() for line in results[-1].targets)


@pytest.mark.parametrize("name", REFUSED)
def test_a_refused_model_is_valid_once_its_messages_are_followed(name, tmp_path):
    text, *steps = REFUSED[name]
    for message, old, new in steps:
        with pytest.raises(GraphError) as error:
            load_graph(with_readings(text, tmp_path))
        assert message in describe_error(error.value) and text.count(old) == 1
        text = text.replace(old, new)
    assert load_graph(with_readings(text, tmp_path)).targets

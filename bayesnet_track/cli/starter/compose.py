"""A first graph as a commented file: the pieces put together, and checked before anybody sees them."""

from __future__ import annotations

from shlex import quote

from bayesnet_track.cli.starter.agents import agents_of, birth_of, camera_of
from bayesnet_track.cli.starter.lines import Lines, indent, key, remark
from bayesnet_track.cli.starter.task import APART, HARD, SPEED, Task

SIZES = {"little": 200, "usual": 500, "much": 1500}
STEPS = {"slow": 0.07, "usual": 0.15, "fast": 0.3}
CHANGES_PX = {"slow": 0.5, "usual": 1, "fast": 2}


_CAMERA = key(
    "camera: compensate",
    "Hypotheses are first moved with the background. Leave this out if the camera does not "
    "move: it costs a few milliseconds.",
)


def graph_text(task: Task, file: str = "") -> str:
    """The graph file for a task; `file` is its path, as its first lines tell it (NAME.yaml when empty)."""
    root = key(
        "target:",
        "The root: it holds the belief about the box. All thresholds of UD, its uncertainty, are "
        "relative to the size of the box, so that they also fit other sizes.",
        (*_belief(task), *_motion(task), *_fuse(task), *_estimate(task), *_adapt(task), *_learn(task)),
    )
    nodes = ("nodes:", *indent((*root, *agents_of(task))))
    lines = (
        *_head(task, file or f"{task.name}.yaml"),
        "bayesnet: 1   # version of the language",
        f"name: {task.name}",
        f"about: {_about(task)}",
        "",
        "targets:",
        *indent(
            key(
                "target:",
                "A type of target: each target of this type gets its own net, as described here.",
                (*birth_of(task), *nodes),
            )
        ),
        *_joins(task),
    )
    return "\n".join(lines) + "\n"


def _about(task: Task) -> str:
    what = "One target" if task.follow == "box" else "Whatever appears"
    return f"{what}, by {' and '.join(task.apart)}."


def _head(task: Task, path: str) -> Lines:
    traits = "; ".join(APART[name] for name in task.apart)
    hard = "; ".join(HARD[name] for name in HARD if name in task.hard) or "nothing special"
    start = "" if birth_of(task) else " --init X,Y,W,H"
    found = " --detections FILE" if task.detected else ""
    # A name may hold blanks, and a line break would end the comment.
    graph = quote(path) if path.isprintable() else "FILE"
    return (
        *remark(f"Written by `bayesnet-track init`. Sets it apart: {traits}. Hard: {hard}."),
        "#",
        *remark(
            "Try it, look at the result and at why agents were switched, then change one thing at a time:"
        ),
        f"#   bayesnet-track run {graph} --source VIDEO{start}{found} --out runs/{task.name}",
        f"#   bayesnet-track report runs/{task.name} --open",
        f"#   bayesnet-track what-if runs/{task.name} --set KEY.KEY=VALUE --truth TRUTH",
        *camera_of(task),
    )


def _belief(task: Task) -> Lines:
    size = SIZES[task.budget]
    if task.belief == "gaussian":
        measured = set(task.apart) <= {"color", "edges", "detections"}
        gate = 1 if task.detected else 0.99
        text = f"{{gaussian: {{filter: kalman, gate: {gate}}}}}" if measured else "gaussian"
        comment = (
            "One mean and covariance. `gate`: measurements outside this share of the prediction are "
            "rejected (1: none). Use `particles` if it follows wrong measurements."
        )
    elif task.belief == "grid":
        text = "{grid: {cell_px: 2, window: 128}}"
        comment = (
            "A distribution over cells. `cell_px`: smaller is finer and more expensive; `window`: cells "
            "across and down, for targets that jump further."
        )
    else:
        text = f"{{particles: {{size: {size}}}}}"
        comment = (
            "Number of hypotheses: more give steadier boxes at proportional cost; fewer than 200 "
            "cannot follow a changing size."
        )
    return key(f"belief: {text}", comment)


def _motion(task: Task) -> Lines:
    step = STEPS[task.speed]
    if task.detected or task.belief == "gaussian":
        return _steady(task)
    inside = key(
        f"sd_box: {{x: {step}, y: {step}}}",
        f"A step, as a share of the box's mean side: {SPEED[task.speed]}. If it is too small, the "
        f"target is lost at the first jump; if too large, neighbours come into reach. A third of "
        f"the largest step is right.",
    )
    if task.belief == "particles" and task.speed != "slow":
        inside += key(
            "heavy_tail: {weight: 0.3, factor: 4}",
            "The share `weight` of the hypotheses spreads `factor` times as far. Leave this out for a"
            " target that never jumps.",
        )
    if task.belief != "grid" or "size" in task.hard:
        scale = 0.04 if "size" in task.hard else 0.01
        inside += key(
            f"sd_log: {{scale: {scale}}}",
            "The size changes by this share per frame. Raise it if the box stays too large or too small.",
        )
    if task.belief != "grid":
        sd = 0.7 if "size" in task.hard else 0.15
        inside += key(
            f"size_reversion: {{sd_scale: {sd}}}",
            "Pulls the size back to that of the first box, so that it cannot shrink to nothing: sd, "
            "in logarithms, that it may reach in the long run.",
        )
    if "rotation" in task.hard and _turns(task):
        inside += key("sd_angle_deg: 5", "It rotates in the image by about this many degrees per frame.")
    if "camera" in task.hard:
        inside += _CAMERA
    if task.belief == "particles" and "occlusion" in task.hard:
        inside += key(
            "relocalize: {share: 0.1, above: {ud_box: 0.5}}",
            "While the belief is uncertain, some hypotheses search the whole frame, where the agents "
            "find something similar. Leave this out if other objects look the same.",
        )
    return key("motion:", "Where it may be in the next frame.", ("random_walk:", *indent(inside)))


def _steady(task: Task) -> Lines:
    """Motion at a velocity that changes slowly: what a Gaussian, and detections, want."""
    inside: Lines = ()
    if task.detected or "size" in task.hard:
        sd = 4 if task.detected else 1
        inside += key(
            f"sd_px: {{w: {sd}, h: {sd}}}", "Noise of the size, px; raise it for targets that come near."
        )
    inside += key(
        f"sd_velocity_px: {CHANGES_PX[task.speed]}",
        "How much its velocity changes from one frame to the next, px; raise it for sudden turns.",
    )
    inside += key("start_velocity_sd_px: 6", "How fast it may be at the start, px per frame.")
    if "camera" in task.hard:
        inside += _CAMERA
    return key(
        "motion:",
        "Where it may be in the next frame: it keeps its velocity.",
        ("constant_velocity:", *indent(inside)),
    )


def _turns(task: Task) -> bool:
    """Whether an agent reads the angle."""
    return "edges" in task.apart


def _fuse(task: Task) -> Lines:
    if len(task.apart) < 2:
        return ()
    return key(
        "fuse: product",
        "The agents are independent given the state of the target, so their likelihoods multiply."
        " Two that see the same evidence belong under a node of their own with `fuse: pool`, "
        "which counts it once.",
    )


def _estimate(task: Task) -> Lines:
    ud = key("ud_fields: [x, y]", "UD counts the position; add w and h if the size matters as much.")
    if task.belief != "particles":
        return (*key("estimate: mean", "The box that is reported: the mean of the belief."), *ud)
    lines = key(
        "estimate: {robust_mean: {box: 0.25}}",
        "The box that is reported: the mean of the hypotheses this near to the best one. `map` is"
        " the single most probable one, and jitters more.",
    )
    return (*lines, *ud)


def _adapt(task: Task) -> Lines:
    if len(task.apart) < 2 or task.detected:
        return ()
    keep = (
        key("keep: 2", "This many agents always stay on.")
        if task.budget == "much" and len(task.apart) > 2
        else ()
    )
    return key(
        "adapt:",
        "Agents are switched off while the belief stays narrow without them, and on when it widens.",
        (
            *key(
                "activate: {above: {ud_box: 0.06}}",
                "On when UD is above this share of the box's area. Lower it if agents are switched on too "
                "late; each sentence of the log names the threshold with which a decision would not have "
                "been taken. `{ud_baseline: 2}` is twice the UD that is measured while nothing is wrong.",
            ),
            *key(
                "deactivate: {below: {ud_box: 0.05}, frames: 3, drop: most_expensive_redundant}",
                "One agent off when UD has been below this for `frames` frames; leave a gap to the "
                "threshold above, and raise both if all agents are on all the time. "
                "`most_expensive_redundant` drops the most expensive agent without which UD would stay "
                "low, `largest_kl` the one that agrees least with the belief.",
            ),
            *keep,
        ),
    )


def _learn(task: Task) -> Lines:
    if task.apart == ("detections",):
        return ()
    rate = 0.05 if "light" in task.hard else 0.03
    guard = ", guard: {rate: 0.002}" if "light" in task.hard or "alike" in task.hard else ""
    comment = (
        "References (what agents have learned about the target) follow it while UD is below this "
        "share of the box's area, by at most this rate per frame (some cues have their own; "
        "`learn_rate_max` of an agent overrides both). A higher rate follows changes better, and "
        "drifts off sooner."
    )
    if guard:
        comment += (
            " `guard`: a second, slow reference stops the learning of an agent that has drifted onto "
            "something else."
        )
    return key(f"learn: {{below: {{ud_box: 0.05}}, rate_max: {rate}{guard}}}", comment)


def _joins(task: Task) -> Lines:
    several = task.follow == "appearing" and "alike" in task.hard
    if not several or task.belief != "particles" or task.detected:
        return ()
    comment = (
        "Two targets that overlap share a belief: no pixel is evidence for both, and the one in "
        "front tends to stay there. Leave this out if they never overlap."
    )
    return ("", *key("joins:", comment, ("- occlusion: {stay: 0.95}",)))

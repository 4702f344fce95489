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
    "Hypotheses are first moved as the background moves. Leave it out when the camera stands still: it "
    "costs a few "
    "milliseconds.",
)


def graph_text(task: Task, file: str = "") -> str:
    """The graph file for a task; `file` is its path, as its first lines tell it (NAME.yaml when empty)."""
    root = key(
        "target:",
        "The root: it holds the belief about the box. All levels of UD, its uncertainty, are relative to "
        "the size of the box, so that they fit other sizes, too.",
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
                "A kind of target: each one gets a net of its own, as described here.",
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
        *remark("Try it, look at it and at why it switched agents, then change one thing at a time:"),
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
            "One mean and covariance. `gate`: measurements beyond this share of the prediction are refused; "
            "`particles` if it is led astray."
        )
    elif task.belief == "grid":
        text = "{grid: {cell_px: 2, window: 128}}"
        comment = (
            "A distribution over cells. `cell_px`: smaller is finer and more expensive; `window`: cells "
            "across and down, for targets that leap further."
        )
    else:
        text = f"{{particles: {{size: {size}}}}}"
        comment = "Hypotheses: more are steadier, and cost in proportion; below 200 a changing size is lost."
    return key(f"belief: {text}", comment)


def _motion(task: Task) -> Lines:
    step = STEPS[task.speed]
    if task.detected or task.belief == "gaussian":
        return _steady(task)
    inside = key(
        f"sd_box: {{x: {step}, y: {step}}}",
        f"A step, as a share of the box's mean side: {SPEED[task.speed]}. Too small, and it is lost at the "
        "first jump; too large, and neighbours come into reach. A third of the largest step is right.",
    )
    if task.belief == "particles" and task.speed != "slow":
        inside += key(
            "heavy_tail: {weight: 0.3, factor: 4}",
            "Some hypotheses look this many times as far. Leave it out for something that never leaps.",
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
            "Draws the size back to that of the first box, so that it "
            "cannot shrink away: how far, in logarithms, it may be in the long run.",
        )
    if "rotation" in task.hard and _turns(task):
        inside += key("sd_angle_deg: 5", "It rotates in the image by about so many degrees per frame.")
    if "camera" in task.hard:
        inside += _CAMERA
    if task.belief == "particles" and "occlusion" in task.hard:
        inside += key(
            "relocalize: {share: 0.1, above: {ud_box: 0.5}}",
            "While it is unsure, some hypotheses look all over "
            "the frame, where the agents find something similar. Leave it out where others look the same.",
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
        "Where it may be in the next frame: on as fast as before.",
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
        "The agents are independent, given where the target is: each counts in full. Two that "
        "see the same thing belong under a node of their own with `fuse: pool`, which counts them once.",
    )


def _estimate(task: Task) -> Lines:
    ud = key("ud_fields: [x, y]", "UD counts the position; add w and h if the size matters as much.")
    if task.belief != "particles":
        return (*key("estimate: mean", "The box that is reported: the mean of the belief."), *ud)
    lines = key(
        "estimate: {robust_mean: {box: 0.25}}",
        "The box that is reported: the mean of what lies this near to the "
        "best hypothesis. `map` is the single most probable one, and shakes more.",
    )
    return (*lines, *ud)


def _adapt(task: Task) -> Lines:
    if len(task.apart) < 2 or task.detected:
        return ()
    keep = (
        key("keep: 2", "So many agents always stay on.")
        if task.budget == "much" and len(task.apart) > 2
        else ()
    )
    return key(
        "adapt:",
        "Agents are switched off while the belief is narrow without them, and on when it grows.",
        (
            *key(
                "activate: {above: {ud_box: 0.06}}",
                "On when UD is above this share of the box's area. Lower it if help comes too late; each "
                "sentence of the log says at which level a decision would not have been taken. "
                "`{ud_baseline: 2}` is twice the level that is measured while all is well.",
            ),
            *key(
                "deactivate: {below: {ud_box: 0.05}, frames: 3, drop: most_expensive_redundant}",
                "One off when UD is below that for so many frames; leave a gap to the level above, and raise "
                "both if all agents work all the time. `most_expensive_redundant` drops the most expensive "
                "one without which UD would stay low, `largest_kl` the one that agrees least.",
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
        "What the target looks like follows it while UD is below this share of the box's area, by at most "
        "this rate per frame (some cues have one of their own: `learn_rate_max` of an agent overrides it). A "
        "faster one follows changes, and drifts off sooner."
    )
    if guard:
        comment += " `guard`: a slow second memory stops an agent that has slid onto something else."
    return key(f"learn: {{below: {{ud_box: 0.05}}, rate_max: {rate}{guard}}}", comment)


def _joins(task: Task) -> Lines:
    several = task.follow == "appearing" and "alike" in task.hard
    if not several or task.belief != "particles" or task.detected:
        return ()
    comment = (
        "Where two of them meet they share a belief: no pixel is evidence for both, and who is in front "
        "stays there. "
        "Leave it out if they never overlap."
    )
    return ("", *key("joins:", comment, ("- occlusion: {stay: 0.95}",)))

"""The pieces of a first graph that say what the agents look at."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bayesnet_track.cli.starter.lines import Lines, key, remark
from bayesnet_track.cli.starter.task import Task


def agents_of(task: Task) -> Lines:
    """Every agent of the task, one line each."""
    lines: Lines = ()
    for name in task.apart:
        lines += _AGENTS[name](task)
    return lines


def _agent(node: str, cue: str, comment: str, more: str = "") -> Lines:
    return key(f"{node}: {{parent: target, agent: {cue}{more}}}", comment)


def _color(task: Task) -> Lines:
    if task.belief == "gaussian":
        comment = (
            "Measures where its colours are: a window that moves to their centre. `seen_above`: share"
            " of them that has to be visible; lower it for a target that changes its colours, raise "
            "it if the window stops at an occluder."
        )
        return _agent("color", "{mean_shift: {seen_above: 0.7}}", comment)
    check, about = _light(task)
    if "alike" in task.hard:
        comment = (
            "Which colours are in the box, and how much of each; the same colours beside it do no "
            "harm. `floor`: its smallest likelihood; smaller ones let it overrule other agents."
        )
        return _agent("color", "{color_histogram: {floor: 0.003}}", comment + about, check)
    comment = (
        "Are there more of the target's colours inside the box than right around it? Use "
        "`color_histogram` if its surroundings often have its colours."
    )
    return _agent("color", "foreground_color", comment + about, check)


def _light(task: Task) -> tuple[str, str]:
    """How an agent that the light deceives watches itself, and what that means."""
    if "light" not in task.hard or len(task.apart) < 2:
        return "", ""
    return ", self_check: {above: {ud_box: 1}, frames: 8}", (
        " `self_check`: when its own likelihood has been as wide as the box for 8 frames, as "
        "after a change of the light, it stops itself for a time; raise `above` if it stops too "
        "often."
    )


def _edges(task: Task) -> Lines:
    if task.belief == "gaussian":
        comment = (
            "Measures where its corners have moved. It needs texture; use `color` or detections for a"
            " target without."
        )
        return _agent("edges", "klt", comment)
    if task.budget == "little" and "rotation" not in task.hard:
        comment = (
            "Directions of edges in 3 by 3 cells of the box: cheap, blind to colour. Use "
            "`correlation_filter` for more precision at three times the cost."
        )
        return _agent("edges", "texture", comment)
    comment = (
        "Does this place look like the middle of the target? A filter that is learnt while "
        "tracking: precise, and it follows slow changes. Use `texture` if it is too expensive."
    )
    return _agent("edges", "correlation_filter", comment)


def _motion(task: Task) -> Lines:
    comment = (
        "Compares the optical flow inside the box with the target's. `coherent_px`: learn no flow"
        " from a box whose vectors differ by more, because it contains two objects. `sd_x_px`, "
        "`sd_y_px`: how exactly the flow has to fit; raise them for blurred frames."
    )
    return _agent("motion", "{motion: {sd_x_px: 1.5, sd_y_px: 1.5, coherent_px: 1}}", comment)


def _depth(task: Task) -> Lines:
    comment = (
        "Distance and size of the object in the box, from two cameras (`run --right`, "
        "`--calibration`) or a depth sensor (`--depth`). `max_depth_m`: nearer than the wall "
        "behind; set it, and `camera_height_m` if a floor is visible, for your room."
    )
    return _agent("depth", "{stereo: {floor: 0.003, max_depth_m: 6.5}}", comment)


def _shape(task: Task) -> Lines:
    comment = (
        "The silhouette, learnt from the first box on; better with `model: FILE` of "
        "`bayesnet-track learn-shape`. `floor`: its smallest likelihood; raise it if this agent "
        "misleads the others."
    )
    return _agent("shape", "{shape: {floor: 0.003}}", comment)


def _detections(task: Task) -> Lines:
    comment = (
        "Measures by the detection that is assigned to the target. `sd_place`, `sd_size`: error "
        "of the detector's boxes, as a share of the box; raise them for an unsteady detector. "
        "`appearance`: weight of the other agents when detections are assigned."
    )
    looks = 0.5 if len(task.apart) > 1 else 0
    return _agent("seen", f"{{detection: {{sd_place: 0.06, sd_size: 0.06, appearance: {looks}}}}}", comment)


_AGENTS: Mapping[str, Callable[[Task], Lines]] = {
    "color": _color,
    "edges": _edges,
    "motion": _motion,
    "depth": _depth,
    "shape": _shape,
    "detections": _detections,
}


def birth_of(task: Task) -> Lines:
    """Where targets come from, and when they go; nothing for one box that is drawn."""
    if task.follow == "box" and not task.detected:
        return ()
    most = "1" if task.follow == "box" else "20"
    detector, comment = _detector(task)
    inside = (
        *key(f"detector: {detector}", comment),
        *key(
            "confirm: {hits: 3, of: 4}",
            "It becomes a target after `hits` detections in the last `of` runs of the detector; raise"
            " both against false detections, lower both for objects that pass quickly.",
        ),
        *key(f"max_targets: {most}", "Largest number of targets at the same time."),
    )
    return (
        *key("birth:", "New targets: detections that no existing target claims.", inside),
        *key(
            "death: {lost_frames: 15}",
            "A target that has been lost for this many frames ends; raise it if targets are hidden "
            "for longer.",
        ),
        *key(
            "reidentify: {frames: 300}",
            "A target that comes back within this many frames, and looks as before, gets its old "
            "number again.",
        ),
    )


def _detector(task: Task) -> tuple[str, str]:
    if task.detected:
        return "detections", "From a file: `run --detections FILE`, MOT text or JSON Lines."
    if task.apart == ("depth",):
        return "stereo_blobs", "Smooth regions of depth of a target's height; see `list` for others."
    least = "`min_area_px`: smaller ones count as noise; set it to a third of the smallest target's area."
    if "camera" in task.hard:
        return "{motion: {min_area_px: 100}}", f"What moves against the rest of the image. {least}"
    return (
        "{background: {min_area_px: 100}}",
        f"What differs from the background of a camera that does not move. {least}",
    )


def camera_of(task: Task) -> Lines:
    """A reminder for sources of depth."""
    if "depth" not in task.apart:
        return ()
    return remark("It needs depth: run --right RIGHT --calibration FILE, or --depth FOLDER.")

"""`fit --motion`: the noise and modes of a graph's motion, by maximum evidence of true or detected boxes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayesnet_track.cli.arguments import UsageError, complain, pixels, users_mistake
from bayesnet_track.journal.text.wording import plural

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayesnet_track.evaluate.motion_fit import Estimate, FittedMotion
    from bayesnet_track.graph.checked import CheckedGraph

    Tracks = Sequence[NDArray[np.float64]]


def fit_motion_text(text: str, graph: CheckedGraph, options: argparse.Namespace) -> tuple[str, str]:
    """The graph's text with the fitted motion, and what it was fitted to; prints each estimate.

    Raises:
        UsageError: options that do not go with it, no boxes, or a motion that cannot be fitted.
    """
    from bayesnet_track.evaluate.motion_fit import fit_motion

    for name in ("what", "guarantee", "alarm", "leave_one_out"):
        if getattr(options, name):
            raise UsageError(f"--motion fits the motion alone; call --{name.replace('_', '-')} separately")
    tracks = tracks_of(options)
    name, plate = next(iter(graph.targets.items()))
    with users_mistake():
        fitted = fit_motion(plate.inference(plate.root), tracks, options.box_sd)
    from_what = f"{plural(fitted.frames, 'frame')} of {plural(len(tracks), 'track')}"
    for line in describe(fitted):
        complain(line)
    return write_motion(text, ("targets", name, "nodes", plate.root), fitted.estimates, from_what), from_what


def tracks_of(options: argparse.Namespace) -> Tracks:
    """(T, 4) centre boxes of each track of `--truth` and `--folder`, up to `--end`."""
    import numpy as np

    from bayesnet_track.evaluate.truth import is_mot, read_mot_tracks, read_truth
    from bayesnet_track.numerics.boxes import centre_from_corner

    files = [Path(file) for file in options.truth]
    if options.folder is not None:
        files += sorted(Path(options.folder).glob("*/groundtruth.txt"))
    if not files:
        raise UsageError("--motion reads boxes and no images: give --truth FILE, or --folder")
    found = []
    for file in files:
        with users_mistake():
            if not is_mot(file, options.truth_format):
                found.append(centre_from_corner(read_truth(file, options.truth_format))[: options.end])
                continue
            tracks = read_mot_tracks(file)
        for one in np.unique(tracks.ids):
            own = tracks.ids == one
            frames = tracks.frames[own] - tracks.frames[own].min()
            boxes = np.full((frames.max() + 1, 4), np.nan)
            boxes[frames] = centre_from_corner(tracks.boxes[own])
            found.append(boxes[: options.end])
    return found


def describe(fitted: FittedMotion) -> list[str]:
    """A line for each estimate, and what it gains."""
    lines = [_line(one) for one in fitted.estimates]
    gain = fitted.log_evidence - fitted.log_evidence_before
    lines.append(
        f"log-evidence {fitted.log_evidence:.1f}, {gain:.1f} above that of the graph's own values, in "
        f"{plural(fitted.frames, 'frame')}"
    )
    return lines


def _line(one: Estimate) -> str:
    name = ".".join(one.path) if one.before == one.before else f"error of the boxes' {one.path[-1]}"
    if not one.is_known:
        kept = f"; the graph's {one.before:g} stays" if one.before == one.before else ""
        return f"{name}: the boxes do not tell; best {one.value:.3g}{kept}"
    before = f"; before {one.before:g}" if one.before == one.before else ""
    return f"{name}: {one.value:.3g}, 90 % interval {one.low:.3g} to {one.high:.3g}{before}"


def write_motion(text: str, node: tuple[str, ...], estimates: Sequence[Estimate], from_what: str) -> str:
    """The graph's text with the estimates that the boxes tell, each with its interval as a comment."""
    from bayesnet_track.graph.text.change import set_value

    for one in estimates:
        if not one.is_known or one.before != one.before:
            continue
        value = float(f"{one.value:.3g}")
        said = f"{one.path[-1]} {one.low:.3g} to {one.high:.3g} (90 %), by evidence; {from_what}"
        try:
            text = set_value(text, (*node, *one.path), value, said)
        except KeyError:  # `motion: constant_velocity`, all defaults
            text = set_value(text, (*node, *one.path[:-2]), {one.path[-2]: {one.path[-1]: value}}, said)
    return text


def add_motion(fit: argparse.ArgumentParser) -> None:
    """`--motion` and `--box-sd`."""
    fit.add_argument(
        "--motion",
        action="store_true",
        help="fit, instead of --what, the noise and modes of the motion by maximum evidence of the boxes of "
        "--truth (no video is needed), with 90 %% intervals",
    )
    fit.add_argument(
        "--box-sd",
        type=pixels,
        metavar="PX",
        help="with --motion: sd of the boxes' errors (default: fitted, too)",
    )

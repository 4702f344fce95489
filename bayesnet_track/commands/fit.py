"""The command `fit`: calibrate a graph on videos with truth, and write what was estimated into its text."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesnet_track.commands.answer import OK, UsageError, complain, say, users_mistake, writing
from bayesnet_track.journal.wording import plural

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bayesnet_track.evaluate.fitting import Checked, Fitted
    from bayesnet_track.evaluate.witness import Witness
    from bayesnet_track.graph.checked import CheckedGraph

WHAT = ("score", "slack", "lost", "ud", "temperature")


@dataclass(frozen=True, eq=False)
class Video:
    """A source and its true corner boxes (n, 4)."""

    name: str
    source: str
    truth: NDArray[np.float64]


def fit(options: argparse.Namespace) -> int:
    """Estimate, print or write."""
    from bayesnet_track.evaluate.fitting import SIGNS, leave_one_out
    from bayesnet_track.evaluate.fitting import fit as estimate
    from bayesnet_track.graph.load import load_graph

    what = _chosen("--what", options.what, WHAT)
    features = _chosen("--features", options.features, tuple(SIGNS))
    graph, text = load_graph(options.graph), graph_text(options.graph)
    out = None if options.out is None else Path(options.out)
    if out is not None:
        with writing(out):
            if out.exists() and not options.overwrite:
                raise UsageError(f"{out} exists; --overwrite replaces it")
    videos = list(_videos(options))
    witnesses = _witness(graph, videos, options, "temperature" in what)
    with users_mistake():
        if options.leave_one_out:
            rows, everyone = leave_one_out(witnesses, features)
            say(calibration_table(rows, everyone))
            return OK
        fitted = estimate(witnesses, features)
    written = write_fitted(text, graph, fitted, what)
    load_written(written, str(out or options.graph))
    if out is None:
        say(written.removesuffix("\n"))
    else:
        _write(out, written)
        say(f"{out}: fitted to {fitted.frames} frames of {plural(fitted.videos, 'video')}")
    return OK


def graph_text(graph: str) -> str:
    """The text of a graph file, or of an installed graph."""
    from bayesnet_track.graphs import find_graph, graph_names

    return (find_graph(graph) if graph in graph_names() else Path(graph)).read_text(encoding="utf-8")


def load_written(text: str, name: str) -> None:
    """Check a graph's text against every law, as a run of it would; raises GraphError."""
    from bayesnet_track.graph.laws import check
    from bayesnet_track.graph.read import read_graph

    check(*read_graph(text, name))


def write_fitted(text: str, graph: CheckedGraph, fitted: Fitted, what: Sequence[str]) -> str:
    """The graph's text with what was estimated, each with a comment that says from what."""
    from bayesnet_track.graph.edit import set_value

    name, plate = next(iter(graph.targets.items()))
    path = ("targets", name, "nodes", plate.root)
    spec = plate.inference(plate.root)
    from_what = f"{fitted.frames} frames of {plural(fitted.videos, 'video')}"

    def put(key: tuple[str, ...], value: Any, comment: str) -> None:
        nonlocal text
        text = set_value(text, (*path, *key), value, comment)

    if "temperature" in what:
        for agent, factor in fitted.temperatures.items():
            value = _short(plate.agent(agent).temperature * factor)
            where = ("targets", name, "nodes", agent, "temperature")
            text = set_value(text, where, value, f"temperature: least surprised by the truth; {from_what}")
    if "ud" in what and spec.adapt is not None:
        for rule, side in (("activate", "above"), ("deactivate", "below")):
            chosen = getattr(getattr(spec.adapt, rule), side, None)
            if chosen is not None:
                share = "90" if rule == "activate" else "50"
                said = f"{share} % of the frames on target lie below; {from_what}"
                put(("adapt", rule, side), {"ud_box": _short(fitted.ud_box[rule])}, said)
    if "ud" in what and spec.learn is not None:
        said = f"67 % of the frames on target lie below, at most 50 % of those off it; {from_what}"
        put(("learn", "below"), {"ud_box": _short(fitted.ud_box["learn"])}, said)
    if "score" in what:
        others = {} if spec.score is None else {"memory": _short(spec.score.settings.memory)}
        if spec.score is not None and spec.score.settings.full_fit > 0:
            others["full_fit"] = _short(spec.score.settings.full_fit)
        values = {name: _short(value) for name, value in fitted.logistic.items() if value or name == "bias"}
        put(("score",), {"logistic": {**values, **others}}, f"probability of IoU > 0.5; {from_what}")
    if "slack" in what:
        sd, lost_sd = (_short(value) for value in fitted.slack)
        put(("slack",), {"sd_box": sd, "lost_sd_box": lost_sd}, f"regions hold 50 % and 90 %; {from_what}")
    if "lost" in what and "score" in what:
        # A rival puts the score at one half, which has to count as uncertain.
        least = 0.0 if spec.rivals is None else 0.51
        levels = {
            "score_below": _short(fitted.levels.score_below),
            "uncertain_below": _short(max(fitted.levels.uncertain_below, least)),
        }
        kept = {} if spec.lost is None else {"fit_below": spec.lost.fit_below, "frames": spec.lost.frames}
        said = f"2 % of the frames on target score below, and most told apart at uncertain; {from_what}"
        put(("lost",), {**levels, **kept}, said)
    return text


def calibration_table(rows: Sequence[Checked], everyone: Checked) -> str:
    """Coverage, ranking and reliability of videos that were not fitted on, in plain text."""
    head = ["video", "frames", "on target", "said", "50 %", "90 %", "AUROC", "Brier"]
    cells = [
        [
            one.name,
            str(one.frames),
            f"{one.on:.3f}",
            f"{one.said:.3f}",
            f"{one.coverage50:.3f}",
            f"{one.coverage90:.3f}",
            "-" if one.auroc is None else f"{one.auroc:.3f}",
            f"{one.brier:.3f}",
        ]
        for one in (*rows, everyone)
    ]
    widths = [max(len(row[k]) for row in [head, *cells]) for k in range(len(head))]
    lines = [
        "  ".join(
            c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in [head, *cells]
    ]
    lines += ["", "score         frames   said    was"]
    lines += [
        f"{one.low:.1f} to {one.high:.1f}  {one.frames:>8}  {one.said:.3f}  {one.was:.3f}"
        for one in everyone.bins
    ]
    return "\n".join(line.rstrip() for line in lines)


def _chosen(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in known:
            raise UsageError(f"{option}: no {name!r}; there are {', '.join(known)}")
    if not names:
        raise UsageError(f"{option} names nothing; there are {', '.join(known)}")
    return names


def _videos(options: argparse.Namespace) -> Iterator[Video]:
    from bayesnet_track.evaluate.truth import read_truth

    if len(options.source) != len(options.truth):
        raise UsageError(
            f"{len(options.source)} --source and {len(options.truth)} --truth: every video needs its truth"
        )
    pairs = [(_name(s), s, Path(t)) for s, t in zip(options.source, options.truth, strict=True)]
    if options.folder is not None:
        found = sorted(Path(options.folder).glob("*/groundtruth.txt"))
        pairs += [(f.parent.name, str(f.parent / "img"), f) for f in found if (f.parent / "img").is_dir()]
        if not found:
            raise UsageError(f"{options.folder}: no NAME/groundtruth.txt beside NAME/img")
    if not pairs:
        raise UsageError("no video: give --source with --truth, or --folder")
    seen: dict[str, int] = {}
    for name, source, file in pairs:
        seen[name] = seen.get(name, 0) + 1
        with users_mistake():
            yield Video(name if seen[name] == 1 else f"{name} {seen[name]}", source, read_truth(file))


def _name(source: str) -> str:
    """What a source is called: a folder of pictures of a sequence is called as the sequence is."""
    path = Path(source)
    return (path.parent if path.name in ("img", "img1") else path).name or source


def _witness(
    graph: CheckedGraph, videos: Sequence[Video], options: argparse.Namespace, temperatures: bool
) -> list[Witness]:
    from bayesnet_track.evaluate.witness import with_features, witness
    from bayesnet_track.planes import Frame
    from bayesnet_track.runtime.sources import open_source

    measuring, found = with_features(graph), []
    for video in videos:
        for seed in range(options.seeds):
            with open_source(video.source, 0, options.end) as source:
                expected = source.expected_frames
                if expected is not None and options.end is None and expected != len(video.truth):
                    raise UsageError(f"{video.name}: {expected} frames, and {len(video.truth)} true boxes")
                frames = (item for item in source if isinstance(item, Frame))
                with users_mistake():
                    one = witness(measuring, video.name, frames, video.truth, seed, temperatures)
            complain(f"{video.name}, seed {seed}: {one.frames} frames, mean IoU {one.iou.mean():.3f}")
            found.append(one)
    return found


def _short(value: float) -> float:
    """Three digits, which is more than is known; whole numbers stay such."""
    return float(f"{value:.3g}")


def _write(path: Path, text: str) -> None:
    """The whole file or none of it."""
    from bayesnet_track.runtime.atomic import write_atomically

    write_atomically(path, text.encode("utf-8"))

"""Text of a fitted graph, with every estimate in its place, and the table of videos that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayesnet_track.journal.text.wording import plural

if TYPE_CHECKING:
    from bayesnet_track.evaluate.calibration import Checked, FittedCalibration
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.graph.spec import Logistic


def further_features(graph: CheckedGraph) -> tuple[str, ...]:
    """The features that the first plate's score has from its verifiers and agents."""
    from bayesnet_track.graph.settings.scores import FEATURES

    score = _score_of(graph)
    return () if score is None else tuple(name for name in score.coefficients if name not in FEATURES)


def used_features(graph: CheckedGraph) -> tuple[str, ...]:
    """The features that the first plate's score goes by; without a score, the usual ones."""
    from bayesnet_track.evaluate.calibration import USUAL_FEATURES

    score = _score_of(graph)
    names = () if score is None else tuple(name for name, slope in score.coefficients.items() if slope)
    return names or USUAL_FEATURES


def has_score(graph: CheckedGraph) -> bool:
    """True if the first plate has a score."""
    return _score_of(graph) is not None


def _score_of(graph: CheckedGraph) -> Logistic | None:
    plate = next(iter(graph.targets.values()))
    score = plate.inference(plate.root).score
    return None if score is None else score.settings


def write_fitted(text: str, graph: CheckedGraph, fitted: FittedCalibration, quantities: Sequence[str]) -> str:
    """The graph's text with what was estimated, each with a comment that says from what."""
    from bayesnet_track.evaluate.calibration import HEAVY_TAIL
    from bayesnet_track.graph.text.change import set_value

    name, plate = next(iter(graph.targets.items()))
    path = ("targets", name, "nodes", plate.root)
    spec = plate.inference(plate.root)
    from_what = f"{fitted.frames} frames of {plural(fitted.videos, 'video')}"

    def put(key: tuple[str, ...], value: Any, comment: str) -> None:
        nonlocal text
        text = set_value(text, (*path, *key), value, comment)

    if "temperature" in quantities:
        for agent, factor in fitted.temperatures.items():
            value = _short(plate.agent(agent).temperature * factor)
            key_path = ("targets", name, "nodes", agent, "temperature")
            text = set_value(
                text, key_path, value, f"temperature: maximum likelihood of the ground truth; {from_what}"
            )
    if "ud" in quantities and spec.adapt is not None:
        for rule, side in (("activate", "above"), ("deactivate", "below")):
            level = getattr(getattr(spec.adapt, rule), side, None)
            if level is not None:
                share = "90" if rule == "activate" else "50"
                explanation = f"{share} % of the frames on target lie below; {from_what}"
                put(("adapt", rule, side), {"ud_box": _short(fitted.ud_box[rule])}, explanation)
    if "ud" in quantities and spec.learn is not None:
        explanation = f"67 % of the frames on target lie below, at most 50 % of those off it; {from_what}"
        put(("learn", "below"), {"ud_box": _short(fitted.ud_box["learn"])}, explanation)
    if "score" in quantities:
        put(("score",), {"logistic": _score_values(graph, fitted)}, f"probability of IoU > 0.5; {from_what}")
    if "localization_error" in quantities:
        sd, lost_sd = (_short(value) for value in fitted.localization_error)
        error = {"sd_box": sd, "lost_sd_box": lost_sd, "heavy_tail": dict(HEAVY_TAIL)}
        put(("localization_error",), error, f"regions hold 50 % and 90 %; {from_what}")
    if "lost" in quantities:
        # A distractor, or what does not fit as the target did, puts the score at one half: that is uncertain.
        halves = spec.distractors is not None or (spec.lost is not None and spec.lost.found_fit is not None)
        lower_bound = 0.51 if halves else 0.0
        levels = {
            "score_below": _short(fitted.levels.score_below),
            "uncertain_below": _short(max(fitted.levels.uncertain_below, lower_bound)),
        }
        set_here = {"above", *levels}
        remaining = {} if spec.lost is None else spec.lost.model_dump(exclude_none=True, exclude=set_here)
        explanation = (
            f"2 % of the frames on target score below, and most told apart at uncertain; {from_what}"
        )
        put(("lost",), {**levels, **remaining}, explanation)
    return text


def _score_values(graph: CheckedGraph, fitted: FittedCalibration) -> dict[str, Any]:
    """The keys of `logistic`: those that were fitted, and those that the graph has beside them."""
    from bayesnet_track.graph.settings.scores import confidence_feature
    from bayesnet_track.graph.text.write import as_plain

    values: dict[str, Any] = {
        name: _short(value) for name, value in fitted.logistic.items() if value or name == "bias"
    }
    rule = _score_of(graph)
    if rule is None:
        return values
    confidence = {agent: values.pop(confidence_feature(agent), 0.0) for agent in rule.confidence}
    verifiers = {
        name: {**as_plain(verifier), "coefficient": values.pop(name, 0.0)}
        for name, verifier in rule.verifiers.items()
    }
    values["memory_frames"] = _short(rule.memory_frames)
    if rule.full_fit > 0:
        values["full_fit"] = _short(rule.full_fit)
    if confidence:
        values["confidence"] = confidence
    if verifiers:
        values["verifiers"] = verifiers
    return values


def calibration_table(rows: Sequence[Checked], everyone: Checked) -> str:
    """Coverage, ranking and reliability of videos that were not fitted on, in plain text."""
    head = ["video", "frames", "on target", "said", "50 %", "90 %", "AUROC", "Brier"]
    cells = [
        [
            checked.name,
            str(checked.frames),
            f"{checked.on:.3f}",
            f"{checked.said:.3f}",
            f"{checked.coverage50:.3f}",
            f"{checked.coverage90:.3f}",
            "-" if checked.auroc is None else f"{checked.auroc:.3f}",
            f"{checked.brier:.3f}",
        ]
        for checked in (*rows, everyone)
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
        f"{score_bin.low:.1f} to {score_bin.high:.1f}  {score_bin.frames:>8}  "
        f"{score_bin.said:.3f}  {score_bin.was:.3f}"
        for score_bin in everyone.bins
    ]
    return "\n".join(line.rstrip() for line in lines)


def _short(value: float) -> float:
    """Three digits, which is more than is known; whole numbers stay such."""
    return float(f"{value:.3g}")

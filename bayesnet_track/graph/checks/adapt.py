"""Checks of adaptation by evidence, and of calibration."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.cues import declares
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.rules.agent_rule import AgentPlace
from bayesnet_track.graph.settings.adapt import Concentrated, Information, Lost
from bayesnet_track.graph.settings.scores import FEATURES
from bayesnet_track.graph.text.messages import GraphMessage
from bayesnet_track.observation.cue import CueDeclaration


def named_agents_are_governed(plate: Plate) -> Iterator[GraphMessage]:
    """Each of `adapt.agents` is an agent below the node, named once, that no rule nearer by switches."""
    for name, node in plate.inference.items():
        named = () if node.adapt is None else node.adapt.agents or ()
        switchable = plate.left_to(name) if named else []
        for number, agent in enumerate(named):
            if agent in named[:number]:
                fault = f"agents names {agent!r} twice"
            elif agent not in plate.agents or agent not in plate.below(name):
                fault = f"agents names {agent!r}, which is no agent below {name}"
            elif agent not in switchable:
                fault = f"agents names {agent!r}, which the rules of {plate.governor[agent]} switch"
            else:
                continue
            remedy = [agent for agent in switchable if agent not in named]
            path = ("adapt", "agents", number)
            yield plate.message(name, fault, remedy or "each once", key=path, word=agent)


def tests_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """`deactivate` asks for no less concentration than `activate`, or both could hold at once."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.activate is None or adapt.deactivate is None:
            continue
        activation, deactivation = adapt.activate.unless, adapt.deactivate.when
        if (
            activation is None
            or deactivation is None
            or activation.concentrated is None
            or deactivation.concentrated is None
        ):
            continue
        for key in ("share", "confidence", "within_box"):
            less, required = getattr(deactivation.concentrated, key), getattr(activation.concentrated, key)
            narrower = key == "within_box"
            if less > required if narrower else less < required:
                yield _looser(plate, name, deactivation.concentrated, key, less, required, narrower)


def _looser(
    plate: Plate,
    name: str,
    deactivation: Concentrated,
    key: str,
    value: float,
    required: float,
    narrower: bool,
) -> GraphMessage:
    path: tuple[str, ...] = ("adapt", "deactivate", "when")
    if deactivation.model_fields_set:
        path += ("concentrated",)
    if key in deactivation.model_fields_set:
        path += (key,)
    default = "" if key in deactivation.model_fields_set else " by default"
    fault = (
        f"adapt.deactivate.when: {key} is {value:.6g}{default}, and {required:.6g} in adapt.activate.unless: "
        "both rules could hold at once"
    )
    return plate.message(name, fault, f"at {'most' if narrower else 'least'} {required:.6g}", key=path)


def information_has_effect(plate: Plate) -> Iterator[GraphMessage]:
    """`information` needs a rule by information, `exploration` needs `which: information_per_ms`."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.information == Information():
            continue
        activates = adapt.activate is not None and adapt.activate.which == "information_per_ms"
        drops = adapt.deactivate is not None and adapt.deactivate.drop == "min_information_per_ms"
        if not activates and not drops:
            remedy = "which: information_per_ms, drop: min_information_per_ms, or no such key"
            fault = "information has no effect: no rule here goes by it"
            yield plate.message(name, fault, remedy, key=("adapt", "information"), on_key=True)
        elif not activates and adapt.information.exploration != Information().exploration:
            key = ("adapt", "information", "exploration")
            fault = "exploration has no effect: only which: information_per_ms hopes for the unknown"
            yield plate.message(
                name, fault, "which: information_per_ms, or no exploration", key=key, on_key=True
            )


def dispensable_by_levels(plate: Plate) -> Iterator[GraphMessage]:
    """`drop: most_expensive_redundant` needs thresholds of UD, not tests."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.deactivate is None or adapt.deactivate.drop != "most_expensive_redundant":
            continue
        levels = [adapt.deactivate.below, *(() if adapt.activate is None else (adapt.activate.above,))]
        if any(level is None or level.kind == "score" for level in levels):
            fault = "drop: most_expensive_redundant asks what UD would be, and a rule here does not go by UD"
            remedy = "levels of UD (above, below), or another drop"
            yield plate.message(name, fault, remedy, key=("adapt", "deactivate", "drop"))


def calls_have_a_caller(plate: Plate) -> Iterator[GraphMessage]:
    """`on_call` stands at the root, without other rules, and leaves agents that run in every frame."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.on_call is None:
            continue
        key = ("adapt", "on_call")
        rules = [rule for rule in ("activate", "deactivate") if getattr(adapt, rule) is not None]
        if node.parent is not None:
            fault = f"on_call at {name}, which is below {', '.join(plate.roots)}"
            yield plate.message(name, fault, "on_call at the root", key=key, on_key=True)
        elif rules:
            fault = f"on_call beside {' and '.join(rules)}: agents on call stay on"
            yield plate.message(name, fault, "one or the other", key=key, on_key=True)
        elif len(plate.governed(name)) == len(plate.agents):
            fault = "on_call leaves no agent that runs in every frame, and could call the others"
            yield plate.message(name, fault, "agents: [...] with some of them", key=key, on_key=True)
        elif adapt.keep != 1:
            yield plate.message(
                name,
                "keep has no effect: agents on call stay on",
                "no keep",
                key=("adapt", "keep"),
                on_key=True,
            )


def calls_say_when_to_learn(plate: Plate) -> Iterator[GraphMessage]:
    """Beside `on_call` references learn in the frames in which the agents run."""
    for name, node in plate.inference.items():
        if node.adapt is None or node.adapt.on_call is None or node.learn is None or node.learn.every == 1:
            continue
        fault = "learn.every has no effect beside on_call: references learn where the agents on call run"
        yield plate.message(name, fault, "no learn.every", key=("learn", "every"), on_key=True)


def called_agents_begin_on(plate: Plate) -> Iterator[GraphMessage]:
    """An agent on call is active at the start: nothing switches it on later."""
    for name, node in plate.inference.items():
        if node.adapt is None or node.adapt.on_call is None:
            continue
        for agent in plate.governed(name):
            if not plate.agents[agent].active:
                fault = "active: false, and nothing switches on an agent on call"
                yield plate.message(agent, fault, "active: true", key=("active",))


def rules_of_agents_fit(plate: Plate) -> Iterator[GraphMessage]:
    """The settings of a rule by which an agent switches itself are possible where the agent stands."""
    for name, node in plate.agents.items():
        siblings = tuple(agent for agent in plate.agents if agent != name)
        for key, rule in node.rules.items():
            for flaw in rule.flaws(AgentPlace(name, plate.cues.get(node.agent.cue), siblings)):
                problem = f"{key}.{flaw.key}: {flaw.problem}"
                yield plate.message(name, problem, flaw.remedy, key=(key, flaw.key))


ADAPT_CHECKS: tuple[Check, ...] = (
    rules_of_agents_fit,
    calls_have_a_caller,
    calls_say_when_to_learn,
    called_agents_begin_on,
    named_agents_are_governed,
    tests_in_order,
    information_has_effect,
    dispensable_by_levels,
)


def score_serves_its_users(plate: Plate) -> Iterator[GraphMessage]:
    """`lost.score_below`, `distractors` and the like need a `score` at the root, which is a probability."""
    if any(node.parent is None and node.score is not None for node in plate.inference.values()):
        return
    for name, node in plate.inference.items():
        levels = {
            ("activate", "above"): getattr(node.adapt and node.adapt.activate, "above", None),
            ("deactivate", "below"): getattr(node.adapt and node.adapt.deactivate, "below", None),
        }
        needing: list[tuple[str, ...]] = [
            ("adapt", *key, "score") for key, level in levels.items() if level and level.kind == "score"
        ]
        if node.lost is not None and node.lost.score_below is not None:
            needing.append(("lost", "score_below"))
        if node.localization_error is not None and node.localization_error.lost_sd_box is not None:
            needing.append(("localization_error", "lost_sd_box"))
        rules = {"distractors": node.distractors, "guarantee": node.guarantee, "alarm": node.alarm}
        needing += [(key,) for key, rule in rules.items() if rule is not None]
        if node.learn is not None and node.learn.score_above is not None:
            needing.append(("learn", "score_above"))
        for key in needing:
            fault = f"{'.'.join(key)} without a score that is a probability"
            yield plate.message(name, fault, "score at the root, or no such key", key=key, on_key=True)


def score_levels_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """`score_below` lies below `uncertain_below`, and one rule decides when a target is lost."""
    for name, node in plate.inference.items():
        rule = node.lost
        if rule is None:
            continue
        low, high = rule.score_below, rule.uncertain_below
        if low is None and high is not None:
            fault = "lost.uncertain_below without lost.score_below"
            yield plate.message(name, fault, "both, or none", key=("lost", "uncertain_below"), on_key=True)
        elif low is not None and high is not None and high <= low:
            fault = f"lost.uncertain_below is {high:.6g}, not above lost.score_below, {low:.6g}"
            yield plate.message(name, fault, f"above {low:.6g}", key=("lost", "uncertain_below"))
        if low is None and rule.found_fit is not None:
            fault = "lost.found_fit without lost.score_below"
            yield plate.message(name, fault, "both, or none", key=("lost", "found_fit"), on_key=True)
        if low is None and rule.regain is not None:
            fault = "lost.regain without lost.score_below"
            yield plate.message(name, fault, "both, or none", key=("lost", "regain"), on_key=True)
        by_fit = node.score is not None and node.score.settings.full_fit > 0.0
        if low is not None and rule.regain is not None and rule.found_fit is None and not by_fit:
            fault = "lost.regain has no effect: neither full_fit of score nor lost.found_fit limits the score"
            yield plate.message(name, fault, "one of these", key=("lost", "regain"), on_key=True)
        if low is not None and rule.above != Lost().above:
            fault = "lost.above has no effect: with score_below the score alone says when the target is lost"
            yield plate.message(name, fault, "one of above, score_below", key=("lost", "above"), on_key=True)


def one_half_is_uncertain(plate: Plate) -> Iterator[GraphMessage]:
    """`distractors` and `found_fit` limit the score to one half: they need an `uncertain_below` above it."""
    for name, node in plate.inference.items():
        high = None if node.lost is None else node.lost.uncertain_below
        if high is not None and high > 0.5:
            continue
        limiting: list[tuple[str, ...]] = []
        if node.distractors is not None:
            limiting.append(("distractors",))
        if node.lost is not None and node.lost.found_fit is not None and node.lost.score_below is not None:
            limiting.append(("lost", "found_fit"))
        for key in limiting:
            verb = "put" if key == ("distractors",) else "puts"
            effect = f"{'.'.join(key)} {verb} the score at one half"
            fault = f"{effect}, which lost.uncertain_below does not call uncertain"
            yield plate.message(name, fault, "lost.uncertain_below above 0.5", key=key, on_key=True)


def localization_error_is_larger_when_lost(plate: Plate) -> Iterator[GraphMessage]:
    """`lost_sd_box` is larger than `sd_box`."""
    for name, node in plate.inference.items():
        error = node.localization_error
        if error is not None and error.lost_sd_box is not None and error.lost_sd_box <= error.sd_box:
            fault = (
                f"localization_error.lost_sd_box is {error.lost_sd_box:.6g}, not above "
                f"localization_error.sd_box, {error.sd_box:.6g}"
            )
            key = ("localization_error", "lost_sd_box")
            yield plate.message(name, fault, f"above {error.sd_box:.6g}", key=key)


def alarm_can_be_raised(plate: Plate) -> Iterator[GraphMessage]:
    """Its e-value stays below the number of calibration videos plus one."""
    for name, node in plate.inference.items():
        if node.alarm is not None and (node.alarm.videos + 1) * node.alarm.share < 1.0 + 1e-9:
            fault = (
                f"alarm of {node.alarm.videos} videos is never raised: its e-value stays below "
                f"{node.alarm.videos + 1}, and has to reach {1.0 / node.alarm.share:.4g}"
            )
            remedy = "more videos, or a larger share"
            yield plate.message(name, fault, remedy, key=("alarm", "videos"))


def verifiers_can_be_asked(plate: Plate) -> Iterator[GraphMessage]:
    """A verifier scores a box by its looks, and has a name that no other feature has."""
    for name, path, choice in plate.spec.cue_choices():
        cue = plate.cues.get(choice.cue)
        if path[0] != "score" or cue is None:
            continue
        verifier = path[3]
        if verifier in RESERVED:
            fault = f"a verifier named {verifier!r}, as something else of the score"
            yield plate.message(name, fault, "another name", key=path[:4], on_key=True)
        why = "measures" if cue.measures else "keeps what cannot be stored" if cue.opaque else ""
        if not cue.is_appearance and not why:
            why = "does not go by the target's looks"
        if why:
            fault = f"verifier {verifier}: {choice.cue} {why}"
            yield plate.message(name, fault, "a cue that scores boxes by looks", key=(*path, choice.cue))


def confidences_are_given(plate: Plate) -> Iterator[GraphMessage]:
    """A score goes by the confidence of agents that have one."""
    able = [name for name, node in plate.agents.items() if declares(plate, node, CueDeclaration.is_sure)]
    for name, node in plate.inference.items():
        for agent in {} if node.score is None else node.score.settings.confidence:
            if agent not in able:
                fault = f"the confidence of {agent!r}, which is no agent that says how sure it is"
                remedy = able or "an agent such as siamese_box"
                key = ("score", "logistic", "confidence", agent)
                yield plate.message(name, fault, remedy, key=key, word=agent, on_key=True)


RESERVED = frozenset({*FEATURES, "most", "bias"})
"""Names that a score or its journal uses already."""

SCORE_CHECKS: tuple[Check, ...] = (
    score_serves_its_users,
    score_levels_in_order,
    one_half_is_uncertain,
    localization_error_is_larger_when_lost,
    alarm_can_be_raised,
    verifiers_can_be_asked,
    confidences_are_given,
)

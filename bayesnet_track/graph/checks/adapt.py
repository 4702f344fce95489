"""Checks of adaptation by evidence: tests that agree with each other, settings that have an effect."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.adapt import Concentrated, Information
from bayesnet_track.graph.text.messages import GraphMessage


def named_agents_are_governed(plate: Plate) -> Iterator[GraphMessage]:
    """Each of `adapt.agents` is an agent below the node, named once, that no rule nearer by switches."""
    for name, node in plate.inference.items():
        named = () if node.adapt is None else node.adapt.agents or ()
        left = plate.left_to(name) if named else []
        for number, agent in enumerate(named):
            if agent in named[:number]:
                found = f"agents names {agent!r} twice"
            elif agent not in plate.agents or agent not in plate.below(name):
                found = f"agents names {agent!r}, which is no agent below {name}"
            elif agent not in left:
                found = f"agents names {agent!r}, which the rules of {plate.governor[agent]} switch"
            else:
                continue
            allowed = [agent for agent in left if agent not in named]
            path = ("adapt", "agents", number)
            yield plate.message(name, found, allowed or "each once", key=path, word=agent)


def tests_in_order(plate: Plate) -> Iterator[GraphMessage]:
    """`deactivate` asks for no less concentration than `activate`, or both could hold at once."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.activate is None or adapt.deactivate is None:
            continue
        on, off = adapt.activate.unless, adapt.deactivate.when
        if on is None or off is None or on.concentrated is None or off.concentrated is None:
            continue
        for key in ("share", "confidence", "within_box"):
            less, wanted = getattr(off.concentrated, key), getattr(on.concentrated, key)
            narrower = key == "within_box"
            if less > wanted if narrower else less < wanted:
                yield _looser(plate, name, off.concentrated, key, less, wanted, narrower)


def _looser(
    plate: Plate, name: str, off: Concentrated, key: str, found: float, wanted: float, narrower: bool
) -> GraphMessage:
    path: tuple[str, ...] = ("adapt", "deactivate", "when")
    if off.model_fields_set:
        path += ("concentrated",)
    if key in off.model_fields_set:
        path += (key,)
    default = "" if key in off.model_fields_set else " by default"
    said = (
        f"adapt.deactivate.when: {key} is {found:.6g}{default}, and {wanted:.6g} in adapt.activate.unless: "
        "both rules could hold at once"
    )
    return plate.message(name, said, f"at {'most' if narrower else 'least'} {wanted:.6g}", key=path)


def information_has_effect(plate: Plate) -> Iterator[GraphMessage]:
    """`information` needs a rule by information, `exploration` needs `which: information_per_ms`."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.information == Information():
            continue
        on = adapt.activate is not None and adapt.activate.which == "information_per_ms"
        off = adapt.deactivate is not None and adapt.deactivate.drop == "min_information_per_ms"
        if not on and not off:
            allowed = "which: information_per_ms, drop: min_information_per_ms, or no such key"
            found = "information has no effect: no rule here goes by it"
            yield plate.message(name, found, allowed, key=("adapt", "information"), on_key=True)
        elif not on and adapt.information.exploration != Information().exploration:
            key = ("adapt", "information", "exploration")
            found = "exploration has no effect: only which: information_per_ms hopes for the unknown"
            yield plate.message(
                name, found, "which: information_per_ms, or no exploration", key=key, on_key=True
            )


def dispensable_by_levels(plate: Plate) -> Iterator[GraphMessage]:
    """`drop: most_expensive_redundant` needs thresholds of UD, not tests."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.deactivate is None or adapt.deactivate.drop != "most_expensive_redundant":
            continue
        if adapt.deactivate.below is None or (adapt.activate is not None and adapt.activate.above is None):
            found = "drop: most_expensive_redundant asks what UD would be, and a rule here goes by a test"
            allowed = "levels of UD (above, below), or another drop"
            yield plate.message(name, found, allowed, key=("adapt", "deactivate", "drop"))


def calls_have_a_caller(plate: Plate) -> Iterator[GraphMessage]:
    """`on_call` stands at the root, without other rules, and leaves agents that run in every frame."""
    for name, node in plate.inference.items():
        adapt = node.adapt
        if adapt is None or adapt.on_call is None:
            continue
        key = ("adapt", "on_call")
        others = [rule for rule in ("activate", "deactivate") if getattr(adapt, rule) is not None]
        if node.parent is not None:
            found = f"on_call at {name}, which is below {', '.join(plate.roots)}"
            yield plate.message(name, found, "on_call at the root", key=key, on_key=True)
        elif others:
            found = f"on_call beside {' and '.join(others)}: agents on call stay on"
            yield plate.message(name, found, "one or the other", key=key, on_key=True)
        elif len(plate.governed(name)) == len(plate.agents):
            found = "on_call leaves no agent that runs in every frame, and could call the others"
            yield plate.message(name, found, "agents: [...] with some of them", key=key, on_key=True)
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
        found = "learn.every has no effect beside on_call: references learn where the agents on call run"
        yield plate.message(name, found, "no learn.every", key=("learn", "every"), on_key=True)


def called_agents_begin_on(plate: Plate) -> Iterator[GraphMessage]:
    """An agent on call is active at the start: nothing switches it on later."""
    for name, node in plate.inference.items():
        if node.adapt is None or node.adapt.on_call is None:
            continue
        for agent in plate.governed(name):
            if not plate.agents[agent].active:
                found = "active: false, and nothing switches on an agent on call"
                yield plate.message(agent, found, "active: true", key=("active",))


ADAPT_CHECKS: tuple[Check, ...] = (
    calls_have_a_caller,
    calls_say_when_to_learn,
    called_agents_begin_on,
    named_agents_are_governed,
    tests_in_order,
    information_has_effect,
    dispensable_by_levels,
)

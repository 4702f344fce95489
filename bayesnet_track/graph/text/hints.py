"""Hints of graph errors: shapes of values in words, and how the usual slips are written."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from bayesnet_track.graph.expressions.terms import WORDS
from bayesnet_track.graph.settings.base import Choice, PluginChoice
from bayesnet_track.graph.text.messages import GraphMessage, listed, shown_name
from bayesnet_track.observation.settings import setting


@dataclass(frozen=True)
class Shape:
    """A type annotation taken apart: alternatives without None, each with its constraints."""

    kinds: tuple[Any, ...]
    constraints: tuple[Any, ...] = ()

    @property
    def only(self) -> Any:
        """The single alternative, or None."""
        return self.kinds[0] if len(self.kinds) == 1 else None

    def takes(self, value: Any) -> bool:
        """True unless a value is no text of the pattern that is needed."""
        patterns = (pattern for c in self.constraints if (pattern := _get(c, "pattern")))
        return all(re.search(pattern, str(value)) for pattern in patterns)


def shape_of(annotation: Any, constraints: Iterable[Any] = ()) -> Shape:
    """Strips `Annotated` and `None` off an annotation."""
    flat = list(_flatten(constraints))
    while True:
        if hasattr(annotation, "__metadata__"):
            flat += _flatten(annotation.__metadata__)
            annotation = annotation.__origin__
            continue
        members = [a for a in get_args(annotation) if a is not type(None)] if _is_union(annotation) else []
        if len(members) != 1:
            break
        annotation = members[0]
    return Shape(tuple(members or [annotation]), tuple(flat))


def expects(annotation: Any, constraints: Iterable[Any] = ()) -> str:
    """Description of a value of this type; empty for a type the language does not use.

    >>> from bayesnet_track.graph.settings.base import Share
    >>> expects(Share), expects(Literal["map", "best"] | None)
    ('a number above 0, at most 1', 'one of map, best')
    """
    shape = shape_of(annotation, constraints)
    if shape.only is None:
        return " or ".join(filter(None, (expects(kind) for kind in shape.kinds)))
    kind = shape.only
    origin = get_origin(kind)
    if origin is Literal:
        words = [shown_name(word) for word in get_args(kind)]
        return words[0] if len(words) == 1 else f"one of {', '.join(words)}"
    if origin is tuple or origin is list:
        return f"a list{_length(get_args(kind), shape.constraints)}, each {expects(get_args(kind)[0])}"
    if origin is not None and issubclass(origin, Mapping):
        return f"a mapping{_key_limit(shape.constraints)}, each {expects(get_args(kind)[1])}"
    if not isinstance(kind, type):
        return ""
    if issubclass(kind, Choice):
        return f"one of {', '.join(kind.model_fields)}"
    if issubclass(kind, PluginChoice):
        return f"a {kind.WORD}, or one {kind.WORD} with its parameters"
    if issubclass(kind, BaseModel):
        return f"a mapping with {listed(kind.model_fields)}" if kind.model_fields else "no settings"
    plain = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}.get(kind, "")
    if not plain:
        return ""
    if any(_get(c, "tag") == "text" for c in shape.constraints):
        plain = "an expression"
    if any(_get(c, "pattern") for c in shape.constraints):
        return "a letter, then up to 63 letters, digits or _"
    return plain + ",".join(_limits(shape.constraints))


def _length(members: tuple[Any, ...], constraints: Iterable[Any]) -> str:
    """Number of members that a list may have: of a tuple by its type, else by constraints; empty for any."""
    if len(members) > 1 and Ellipsis not in members:
        return f" of {len(members)}"
    bounds = {
        name: bound
        for constraint in constraints
        for name in ("min_length", "max_length")
        if (bound := _get(constraint, name)) is not None
    }
    smallest, largest = bounds.get("min_length"), bounds.get("max_length")
    if largest is None:
        return f" of at least {smallest}" if smallest else ""
    if smallest == largest:
        return f" of {largest}"
    return f" of {smallest} to {largest}" if smallest else f" of at most {largest}"


def _key_limit(constraints: Iterable[Any]) -> str:
    """Number of keys that a mapping may have, where that is few."""
    limit = min((bound for c in constraints if (bound := _get(c, "max_length")) is not None), default=99)
    return f" of at most {limit} keys" if limit < 20 else ""


def _limits(constraints: Iterable[Any]) -> Iterator[str]:
    words = (
        ("gt", " above {}"),
        ("ge", " at least {}"),
        ("lt", " below {}"),
        ("le", " at most {}"),
        ("multiple_of", " a multiple of {}"),
        ("max_length", " of at most {} characters"),
    )
    for constraint in constraints:
        for attribute, text in words:
            bound = _get(constraint, attribute)
            if bound is not None:
                yield text.format(f"{bound:.15g}" if isinstance(bound, float) else bound)


def _flatten(constraints: Iterable[Any]) -> Iterator[Any]:
    for constraint in constraints:
        if isinstance(constraint, FieldInfo):
            yield from constraint.metadata
        else:
            yield constraint


def _get(constraint: Any, attribute: str) -> Any:
    return getattr(constraint, attribute, None)


def _is_union(annotation: Any) -> bool:
    return get_origin(annotation) in (Union, UnionType)


NODE_KEYS = frozenset({"parent", "agent", "factor", "belief", "motion"})
"""Keys by which a node is known wherever it stands."""

A_NODE = "this looks like a node: indent it under `nodes:`"

Rule = tuple[str, Callable[[re.Match[str], GraphMessage], str]]

_FILTERS = ("kalman", "extended_kalman", "unscented_kalman", "ekf", "ukf")


def hint_of(message: GraphMessage) -> str:
    """Hint how it is mended, in one line; empty where the message says it all.

    >>> hint_of(GraphMessage("a.yaml", 1, 1, (), "f", "character '^'", "numbers, names, + - * / ** ( )"))
    'a power is x ** 2'
    """
    if message.hint:
        return message.hint
    text = f"{message.found}; allowed: {message.allowed}"
    for pattern, words in (*RULES, *OTHER_FORMS):
        match = re.search(pattern, text)
        if match:
            return words(match, message)
    return ""


SMALL_PX2 = 5.0
"""A threshold below it is none in px²: a belief of one pixel would pass it."""


def _parent(_: re.Match[str], message: GraphMessage) -> str:
    parent = "NODE" if message.allowed.startswith("the name") else message.allowed.partition(",")[0]
    return (
        f"an agent scores the hypotheses of the node above it; name that node, as in parent: {parent}; "
        "a root has no agent"
    )


def _own_cue(_: re.Match[str], message: GraphMessage) -> str:
    """A name that is like no installed cue's is no slip of the pen."""
    if message.nearest:
        return ""
    cue_file, plugin = setting("--cue-file", "FILE", "[FILE]"), setting("--allow-plugins", "NAME", "['NAME']")
    return f"a cue of your own is given as {cue_file}, one of another package as {plugin}"


def _opened(construct: str, or_else: str = "") -> Callable[[re.Match[str], GraphMessage], str]:
    def say(match: re.Match[str], message: GraphMessage) -> str:
        line = match.groupdict().get("line") or message.line
        return f"{construct} in line {line} is not closed{or_else}"

    return say


def _colon(match: re.Match[str], message: GraphMessage) -> str:
    line = match["line"] or message.line
    return f"in line {line}, a key is followed by a colon and a space, as in bayesnet: 1"


_SIGNS = {
    "=": "two values are compared by ==",
    "'": "names, also those of modes and of values of categories, stand without quotes",
    "%": "the remainder is mod(a, b); a share is a number such as 0.05",
    "&": "two conditions are joined by `and`",
    "|": "two conditions are joined by `or`",
    "^": "a power is x ** 2",
    "!": "the opposite is `not`, unequal is !=",
    "?": "one of two values is where(condition, a, b)",
    "~": "a factor is the density itself: normal(h, 12, 3)",
    "[": "a mode, a value or a quantity is named alone; lists are not of the language",
    "{": "a mode, a value or a quantity is named alone; mappings are not of the language",
}
_SIGNS |= dict.fromkeys(('"',), _SIGNS["'"])
_FUNCTIONS = {
    **dict.fromkeys(("gaussian", "gauss", "norm", "N", "Normal", "Gaussian"), "normal(value, mean, sd)"),
    **dict.fromkeys(("cauchy", "Cauchy"), "student_t with 1 degree of freedom"),
    **dict.fromkeys(("round", "ceil", "int", "trunc"), "floor(a + 0.5) is the nearest whole number"),
    **dict.fromkeys(("pow", "square", "sqr"), "a power is x ** 2"),
    **dict.fromkeys(("arctan", "atan"), "atan2(y, x), whose angle is right in every quadrant"),
    **dict.fromkeys(("If", "iff", "ifelse", "if"), "where(condition, a, b)"),
    **dict.fromkeys(("ln", "log10"), "log(a), the natural logarithm"),
}
_NOISE = (
    "this is the value itself, without noise, of which the sd stands under `sd`; "
    "a density is a number, of a value that stands first: normal(value, mean, sd)"
)


def _sign(match: re.Match[str], _: GraphMessage) -> str:
    return _SIGNS.get(match["sign"] or match["quote"], "")


def _function(match: re.Match[str], message: GraphMessage) -> str:
    return "" if message.nearest else _FUNCTIONS.get(match["word"], "")


def _without_value(_: re.Match[str], message: GraphMessage) -> str:
    """A distribution without the value that it is the density of, where nothing is drawn."""
    if {"drift", "measures"} & {*message.path}:
        return _NOISE
    is_noise = "sd" in message.path and "expressions" in message.path
    return "the noise of a motion is normal: an sd alone, such as sd: {x: 3}" if is_noise else ""


def _unknown_constant(match: re.Match[str], message: GraphMessage) -> str:
    """A distribution where a number is needed: its start prior, of a field that is named or still to be."""
    name = message.path[-2] if "fields" in message.path else match["key"]
    prior = f'with a start prior beside the motion, start: {{{name}: "{match["text"]}"}}'
    if "fields" in message.path:
        return f"fields: {{{name}: {{}}}} {prior}"
    motion = f"motion: {{expressions: {{fields: {{{name}: {{}}}}, sd: {{x: {name}, ..}}}}}}"
    return f"an unknown constant is a field of a motion by expressions: {motion}, {prior}"


def _of_parent(match: re.Match[str], message: GraphMessage) -> str:
    """A name of the node above that it does not have: what fields it has, and what stands without it."""
    _, _, name = match["name"].partition(".")
    if name in message.allowed.split(", "):
        return f"constants stand alone: {name}"
    if not name or "." in name:
        return "a field of the node above is parent.x; those of the root's motion are in all nodes below it"
    written = f", as {name} in motion: {{expressions: {{fields: {{{name}: {{sd: 1}}}}, ..}}}}"
    example = "" if name in WORDS else written
    return (
        f"beside its box the node above has the fields of the root's motion{example}; modes, inputs, the "
        "time and the frame are not among them"
    )


def _of_three(match: re.Match[str], _: GraphMessage) -> str:
    """A join of three targets or more: their kinds in pairs."""
    kinds = list(dict.fromkeys(re.findall(r"\w+", match["kinds"])))
    if len(kinds) == 1:
        pair = f"[{kinds[0]}, {kinds[0]}]"
        return f"a factor is of two targets, a and b: between: {pair} relates every pair of them"
    pairs = ", ".join(f"between: [{first}, {second}]" for first, second in pairwise(kinds))
    return f"a factor is of two targets, a and b; several are related by a join for each pair: {pairs}"


def _uncertainty(match: re.Match[str], _: GraphMessage) -> str:
    """The unit that a threshold of UD without one can have: shares of a box are small, px² are many."""
    value = float(match["value"])
    unit, meaning = (
        ("ud_box", "a share of the box's area")
        if value < 1
        else ("ud_baseline", "times the usual UD")
        if value < SMALL_PX2
        else ("ud_px2", "px²")
    )
    return f"write {match['key']}: {{{unit}: {match['value']}}}, {meaning}"


def _always(text: str) -> Callable[[re.Match[str], GraphMessage], str]:
    return lambda match, message: text


_COMMA = ", or a comma is missing"
RULES: Sequence[Rule] = (
    (r"'\\t'", _always("YAML is indented by spaces; a tab stands at the beginning of this line")),
    (
        r"while parsing a flow mapping(?: from line (?P<line>\d+))?",
        _opened("the brace {", _COMMA),
    ),
    (
        r"while parsing a flow sequence(?: from line (?P<line>\d+))?",
        _opened("the bracket [", _COMMA),
    ),
    (r"while scanning a quoted scalar(?: from line (?P<line>\d+))?", _opened("the quote")),
    (
        r"expected <block end>, but found '<block mapping start>'",
        _always("the keys of one mapping begin in the same column; this one does not"),
    ),
    (r"expected '<document start>'", _always("a key is followed by a colon and a space, as in bayesnet: 1")),
    (r"(?:from line (?P<line>\d+) )?could not find expected ':'", _colon),
    (
        r"mapping values are not allowed here",
        _always("one key and one colon a line, or braces; or the line above lacks its colon"),
    ),
    (
        r"expected <block end>, but found '-'",
        _always("nodes and keys are no list: leave out the - at the beginning"),
    ),
    (
        r"^(?P<key>\w+):(?P<value>[\d.]+) is empty",
        lambda match, _: f"a space follows the colon: {match['key']}: {match['value']}",
    ),
    (
        rf"^unknown belief '(?:{'|'.join(_FILTERS)})'",
        _always(
            "a Kalman filter is a filter of the Gaussian belief: write belief: {gaussian: {filter: kalman}}"
        ),
    ),
    (
        r"^associate is '(?:jpda|JPDA|pda|soft)'",
        _always("joint probabilistic data association is associate: marginal"),
    ),
    (r"^key 'parent' is missing", _parent),
    (r"^unknown cue '[^']+'", _own_cue),
    (
        r"^(?P<key>above|below) is (?P<value>-?[\d.]+); allowed: one of ud_px2, ud_box, ud_baseline",
        _uncertainty,
    ),
    (r"^\d+ is empty; allowed: a value", _always("numbers have a decimal point, no comma")),
)
"""Pattern of found and allowed -> the hint; the first that fits."""

OTHER_FORMS: Sequence[Rule] = (
    (r"^character (?:'(?P<sign>.)'|\"(?P<quote>.)\")", _sign),
    (r"^unknown function '(?P<word>\w+)'", _function),
    (
        r"^(?P<key>hidden|existence|identity|gaussian|particles|grid) is empty; allowed: a value",
        lambda match, _: f"its defaults are written {match['key']}: {{}}",
    ),
    (r"^'if' where", _always("one of two values is where(condition, a, b)")),
    (
        r"^(?:normal|laplace|student_t|logistic|uniform|lognormal|gamma|exponential)\w* with \d",
        _without_value,
    ),
    (
        r"; allowed: a number[\w ]* or an expression",
        _always('an expression or a distribution is written as text: "normal(12, 3)"'),
    ),
    (
        r"^(?P<key>\w+) is '(?P<text>[a-z_]+\(.*\))'; allowed: a number$",
        _unknown_constant,
    ),
    (
        r"^\w+ is '[^']+'; allowed: a number$",
        lambda _, message: (
            "a constant is a number; what is computed with it stands where it is read"
            if message.path[0] == "constants"
            else ""
        ),
    ),
    (r"^(?:unknown name )?'(?P<name>parent[\w.]*)'", _of_parent),
    (
        r"^unknown name 'mode'",
        _always("each mode has a motion of its own: modes: {NAME: {motion: ..}}"),
    ),
    (
        r"^unknown key '(?:heavy_tail|noise|robust|cov|covariance)'; allowed: floor, file, sd",
        _always('errors are independent, each by its sd, or heavy-tailed: sd: {x: "student_t(2, 3)", y: 2}'),
    ),
    (
        r"^unknown key '(?P<key>relocalize|camera|inflate|size_reversion)'; allowed: fields, drift",
        lambda match, _: (
            f"{match['key']} changes the drift or the noise of the motions that are not written out, such as "
            "constant_velocity; beside expressions say it in drift or sd, of a camera by inputs"
        ),
    ),
    (
        r"^unknown key 'delay'",
        _always(
            "delay is of readings that come late: agent: {readings: {file: FILE.csv, sd: {u: 3}, delay: 2}}"
        ),
    ),
    (r"^between is \[(?P<kinds>[^\]]*,[^\]]*,[^\]]*)\]", _of_three),
    (
        r"beside state: point; allowed: agents of|^state: point without an agent",
        _always(
            "a target that is looked at in images, or starts in a box, has a size: leave out `state: point`; "
            "a point is of sensors, agent: {detection: {sd: {range: 3, bearing: 0.02}, within: ..}}"
        ),
    ),
    (
        r"^unknown key 'source'",
        _always(
            "what another camera measured is given as a file: agent: {readings: {file: FILE.csv, sd: {u: 3, "
            "v: 3}}} with measures: {u: .., v: ..}; its images are looked at below a view, camera: NAME, of "
            "a camera with a calibration"
        ),
    ),
    (
        r"^unknown key 'confusion'",
        _always(
            "how probable each label is, is of the agent: agent: {detection: {confusion: {team: {red: "
            "{red: 0.9, blue: 0.1}, ..}}}}, with category: {team: {values: [red, blue]}} at the root"
        ),
    ),
    (
        r"cannot be distinguished from .*: they have",
        _always(
            "what a target is and stays is no mode: category: {team: {values: [red, blue]}} at the root, "
            "with labels of detections or a factor as evidence"
        ),
    ),
)
"""The same of what is said in another form: what a model would need -> how this language says it."""

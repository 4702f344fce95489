"""Change values of a graph's text and leave the rest as it is: order, comments and layout."""

from __future__ import annotations

from typing import Any

import yaml

from bayesnet_track.graph.text.write import flow_text

MARK = "# fit: "
"""How a comment begins that belongs to a value that was set here, and goes with it."""


def set_value(text: str, path: tuple[str, ...], value: Any, comment: str = "") -> str:
    """The YAML text with plain data `value` at `path`, whose mapping must be there.

    A key that is there gets the new value in its place; a new one is the last of its mapping. `comment`
    stands on a line of its own above the key (above the nearest key that begins a line where the mapping is
    written in one line), in place of an earlier one that was set here.

    Raises:
        KeyError: the mapping that should hold the key is not there.

    >>> print(set_value("a:\\n  b: 1 # one\\n  c: {d: 2}  # two\\n", ("a", "c", "e"), 3.5, "by hand"), end="")
    a:
      b: 1 # one
      # fit: by hand
      c: {d: 2, e: 3.5}  # two
    """
    top = yaml.compose(text, Loader=yaml.SafeLoader)
    holder, line = top, None
    for name in path[:-1]:
        key, holder = _entry(holder, name)
        line = key.start_mark.line if _begins(text, key) else line
    if not isinstance(holder, yaml.MappingNode):
        raise KeyError(path)
    written = flow_text(value)
    found = {key.value: (key, inside) for key, inside in holder.value}
    if path[-1] in found:
        key, inside = found[path[-1]]
        end = _end(text, inside)
        text = f"{text[: inside.start_mark.index]}{written}{text[end:]}"
        if _begins(text, key):
            line = key.start_mark.line
    elif holder.flow_style:
        close = holder.end_mark.index - 1
        body = text[:close].rstrip()
        joint = " " if body.endswith(",") else ", " if holder.value else ""
        text = f"{body}{joint}{path[-1]}: {written}{text[close:]}"
    else:
        first = holder.value[0][0].start_mark
        end = _end(text, holder.value[-1][1])
        end = _line_end(text, end)
        line = text.count("\n", 0, end) + 1
        text = f"{text[:end]}\n{' ' * first.column}{path[-1]}: {written}{text[end:]}"
    return _comment(text, line or 0, comment)


def _entry(holder: Any, name: str) -> tuple[Any, Any]:
    if isinstance(holder, yaml.MappingNode):
        for key, inside in holder.value:
            if key.value == name:
                return key, inside
    raise KeyError(name)


def _begins(text: str, key: Any) -> bool:
    """Whether nothing but space stands before the key in its line."""
    begin = text.rfind("\n", 0, key.start_mark.index) + 1
    return not text[begin : key.start_mark.index].strip()


def _end(text: str, node: Any) -> int:
    """Where a value ends: a block collection's mark lies behind the comments that follow it."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        node = last[1] if isinstance(last, tuple) else last
    end: int = node.end_mark.index
    return len(text[:end].rstrip()) if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">") else end


def _line_end(text: str, index: int) -> int:
    found = text.find("\n", index)
    return len(text) if found < 0 else found


def _comment(text: str, line: int, comment: str) -> str:
    lines = text.split("\n")
    indent = lines[line][: len(lines[line]) - len(lines[line].lstrip())]
    begin = line
    while begin > 0 and lines[begin - 1].lstrip().startswith(MARK):
        begin -= 1
    said = [f"{indent}{MARK}{part}" for part in comment.split("\n")] if comment else []
    return "\n".join([*lines[:begin], *said, *lines[line:]])

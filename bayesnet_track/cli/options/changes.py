"""`--set PATH=VALUE`: other values in a graph, without another file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import UsageError

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.observation.masks import Mask


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """`--set`, which may be repeated."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="change a value of the graph: keys joined by dots (targets, the plate and nodes may be "
        "left out), and YAML, as in square.adapt.activate.above.ud_px2=200; may be repeated",
    )


def set_values(
    text: str, changes: Sequence[str], adaptation: bool = True, masks: Mapping[str, Mask] | None = None
) -> CheckedGraph:
    """The graph of a canonical text with other values; `adaptation` is False for all agents always on.

    Raises:
        UsageError: a path or a value that is none; says which names there are, and the nearest.
        GraphError: what comes out fails a check.
    """
    from bayesnet_track.graph.text.change import ChangeError, change_graph

    try:
        return change_graph(text, changes, adaptation, masks)
    except ChangeError as error:
        raise UsageError(f"--set {error}") from error

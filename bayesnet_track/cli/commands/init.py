"""The command `init`: a commented graph of the library, copied for a task of one's own."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

from bayesnet_track.cli.commands.answer import OK, UsageError, say, writing

HEAD = """\
# A copy of the graph {source}. Try it, look at the result and at why agents were switched, then change one
# thing at a time:
#   bayesnet-track run {path} --source VIDEO --init X,Y,W,H --out runs/{name}
#   bayesnet-track report runs/{name} --open
#   bayesnet-track what-if runs/{name} --set KEY.KEY=VALUE --truth TRUTH
"""
NO_NAMES = frozenset({"null", "true", "false"})
"""Words that YAML takes for something else."""


def init(options: argparse.Namespace) -> int:
    """Copy a graph of the library."""
    from bayesnet_track.graph.checks.run import check
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graphs import find_graph

    path = Path(options.file)
    with writing(path):
        if path.exists() and not options.overwrite:
            raise UsageError(f"{path} is there already; `--overwrite` replaces it")
    try:
        text = find_graph(options.source).read_text(encoding="utf-8")
    except KeyError as error:
        raise UsageError(str(error.args[0])) from None
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)[:60]
    name = name if name[:1].isalpha() and name.lower() not in NO_NAMES else f"graph_{name}"
    text = re.sub(r"(?m)^name: .*$", f"name: {name}", text, count=1)
    head = HEAD.format(source=options.source, path=path.as_posix().replace("\n", " "), name=name)
    check(*read_graph(head + text, str(path)))
    with writing(path):
        path.write_text(head + text, encoding="utf-8")
    say(f"wrote {path}; its first lines say what to do next")
    return OK


def add_init(commands: argparse._SubParsersAction[Any]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "init",
        help="write a commented graph, copied from one of the library",
        description="Copy a graph of the library, with its comments, to begin your own. "
        "`bayesnet-track list` names the graphs and says what each is for.",
    )
    parser.add_argument(
        "file", nargs="?", default="mine.yaml", metavar="FILE", help="graph file to write (default mine.yaml)"
    )
    parser.add_argument(
        "--from",
        dest="source",
        default="adaptive",
        metavar="GRAPH",
        help="installed graph to copy (default adaptive: one target, by color and edges)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists")

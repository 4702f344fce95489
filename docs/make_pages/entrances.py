"""The page of all entrances of data, made from their table.

python docs/make_pages/entrances.py > docs/entrances.md
"""

from __future__ import annotations

import sys

from bayesnet_track.sources.entrances.table import ENTRANCES, Entrance

HEAD = """\
# What you give, and what is not used

<!-- Made by python docs/make_pages/entrances.py; do not edit. -->

Everything that enters from outside follows one rule: **it is used, or a notice says what is not, or an error
refuses it.** A notice is a line on stderr of the command line, and a warning (`InputNotice`) at your line in
Python; the run goes on. An error says where, what was found, what is allowed and how to mend it. What fits
two readings is refused, and both are named, unless a key or an option says which is meant.

Boxes without an area and boxes that are not finite are left out and counted, by one rule for all entrances.
"""


def entrances_page() -> str:
    """The page as Markdown."""
    return "\n".join([HEAD, *(_section(entrance) for entrance in ENTRANCES)])


def _section(entrance: Entrance) -> str:
    lines = [f"## {entrance.name[0].upper()}{entrance.name[1:]}", "", f"Given by {entrance.reached}.", ""]
    parts = (("Said", entrance.says), ("Refused", entrance.refuses), ("Two readings", entrance.confused))
    lines += [f"- **{name}:** {text}." for name, text in parts]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(entrances_page())

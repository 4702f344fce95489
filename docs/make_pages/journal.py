"""The documentation of the journal's files, a page per kind of event, made from the event classes.

python docs/make_pages/journal.py
"""

from __future__ import annotations

import re
import types
from collections.abc import Mapping
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_args

from bayesnet_track.journal.codec import event_name, field_names, type_hints
from bayesnet_track.journal.encoder import FLOAT_DIGITS
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.lives import Recognition
from bayesnet_track.journal.events.runs import JOURNAL_VERSION
from bayesnet_track.journal.metrics import FrameMetrics, JoinMetrics, PartMetrics
from bayesnet_track.journal.target_net import Cause, Concentration

_FIELD = re.compile(r"^    (\w+): (.*)$")


def parts_of(kind: type) -> tuple[str, Mapping[str, str]]:
    """The text of a class' docstring before its attributes, and each attribute's description.

    >>> parts_of(Cause)[1]["level"]
    'the threshold in that unit.'
    """
    text, _, attributes = cleandoc(kind.__doc__ or "").partition("\nAttributes:\n")
    described: dict[str, str] = {}
    name = ""
    for line in attributes.splitlines():
        field = _FIELD.match(line)
        if field:
            name = field.group(1)
            described[name] = field.group(2)
        elif name:
            described[name] = f"{described[name]} {line.strip()}".strip()
    return text.strip(), described


FOLDER = Path(__file__).parents[1] / "journal"

PAGES: Mapping[str, tuple[str, str]] = {
    "runs": ("The run and its source", "start and end, missing and damaged frames"),
    "switches": ("Switches", "agents on and off by rules, with the numbers behind it"),
    "statuses": ("Status", "tracking, lost, found again, look-alikes, alarms, scene cuts"),
    "beliefs": ("Beliefs", "resets, sizes, modes, gated measurements"),
    "lives": ("Targets", "births, ends, returns"),
    "cameras": ("Cameras", "clocks that were learnt"),
    "refused": ("Refused detections", "which bound kept a detection from a target that had none"),
    "joins": ("Joins", "targets that come together, cover each other and part"),
    "load": ("Hands and load", "what a person switched, what was shed for time"),
    "faults": ("Faults", "agents, formulas and detectors that failed"),
}
"""Heading and contents of the page of each module of events."""


def document_events() -> dict[str, str]:
    """The text of each page by file name: events, measurements and inputs, field by field."""
    kinds = get_args(Event)
    groups: dict[str, list[type]] = {module: [] for module in PAGES}
    for kind in kinds:
        groups[kind.__module__.rpartition(".")[2]].append(kind)
    outside = [kind for kind in get_args(Input) if kind not in kinds]
    both = ", ".join(f"`{event_name(kind)}`" for kind in get_args(Input) if kind in kinds)
    events = {
        module: ", ".join(f"`{event_name(kind)}`" for kind in group) for module, group in groups.items()
    }
    rows = [
        f"| [{title}]({module}.md) | {about} | {events[module]} |" for module, (title, about) in PAGES.items()
    ]
    tree = "\n".join([*PAGES, "measurements", "inputs"])
    pages = {
        "index": [
            _HEAD.format(version=JOURNAL_VERSION, digits=FLOAT_DIGITS, mark=_MARK, rows="\n".join(rows)),
            f"```{{toctree}}\n:maxdepth: 1\n:hidden:\n\n{tree}\n```",
        ],
        **{
            module: [f"# {title}: lines of `journal.jsonl`", _MARK, *map(_of_event, groups[module])]
            for module, (title, _) in PAGES.items()
        },
        "measurements": [
            "# What was measured, frame by frame",
            _MARK,
            _COLUMNS,
            _of_event(FrameMetrics),
            *(_section(kind, f"`{_in_lines(kind)}`") for kind in (PartMetrics, JoinMetrics)),
        ],
        "inputs": [
            "# Lines of `inputs.jsonl`, and objects inside lines",
            _MARK,
            f"External inputs; the file exists only if there were any. {both} are in the journal, too.",
            *map(_of_event, outside),
            *(_section(kind, f"`{_in_lines(kind)}`") for kind in (Cause, Concentration, Recognition)),
        ],
    }
    return {f"{name}.md": "\n\n".join(sections) + "\n" for name, sections in pages.items()}


def _of_event(kind: type) -> str:
    return _section(kind, f"`{event_name(kind)}`")


def _in_lines(kind: type) -> str:
    """The name of an object inside lines.

    >>> _in_lines(PartMetrics)
    'part_metrics'
    """
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower()


def _section(kind: type, title: str) -> str:
    text, described = parts_of(kind)
    rows = [
        f"| `{key}` | {words_of(type_hints(kind)[name])} | {described[name].replace('|', chr(92) + '|')} |"
        for key, name in field_names(kind).items()
    ]
    return "\n".join([f"## {title}", "", text, "", "| field | type | meaning |", "|---|---|---|", *rows])


def words_of(hint: Any) -> str:
    """A type in words of JSON."""
    inner = get_args(hint)
    if isinstance(hint, types.UnionType):
        return " or ".join(words_of(part) for part in inner)
    if not inner:
        return _WORDS.get(hint, event_name(hint))
    if _WORDS.get(inner[0]) == "text" and len(inner) == 2 and inner[1] is not Ellipsis:
        return f"object: name to {words_of(inner[1])}"
    return (
        f"list of {words_of(inner[0])}"
        if inner[-1] is Ellipsis
        else f"list of {len(inner)} {words_of(inner[0])}s"
    )


_WORDS: Mapping[Any, str] = {
    float: "number",
    int: "integer",
    bool: "true or false",
    str: "text",
    type(None): "null",
}

_COLUMNS = """\
A record per frame, each of them a gzip member with one NumPy array, so that `gzip` and `numpy.load` read
the file without this package:

```python
import gzip

import numpy as np

with gzip.open("runs/mine/frames.npy.gz") as file:
    frame = np.load(file)  # the first frame with targets; again for the next one
    print(frame["frame"], frame["target"], frame["box"])  # texts (T,), centre boxes (4, T)
```

- A column has a number per target; `box`, `map`, `sd` and regions have four rows of them. `frame` and
  `time_s` are of the whole frame.
- What is measured of nodes has a column each: `kl/NODE`, `parts/PART/box`. `active` and `silent` are names
  separated by spaces, `join` is JSON.
- Numbers are single precision (seven digits), double where that cannot hold them; `time_s` is double. In
  frames of more than 8 targets, widths and measures of information (`sd`, `ud_px2`, `kl/NODE` and others)
  are half precision (three digits), unless `run --all-hypotheses` asks for all.
- Where a target has no value, there is a NaN with the bits 0x7FE00000 (0x7F00 in half precision). A column
  without any value is left out, and so is a region that is a Gaussian's: `map` ± 0.674 `sd` or ± 1.645 `sd`.
- `cloud` (4, M) has some of the hypotheses of all targets in a row, `cloud_count` (T,) how many are of
  each. They are written in frames of at most 8 targets, and in every frame with `run --all-hypotheses`.
- A header says how long each record is and which frame it holds (extra field `BT`: bytes and targets, 32
  bits each, frame, 64 bits), so that one frame is found without reading the others.
- A killed run leaves whole records and perhaps a truncated last one, which readers drop.

`export --format frames` writes one JSON object per target and frame, with these keys in this order:
"""

_MARK = "<!-- Made by python docs/make_pages/journal.py; do not edit. -->"

_HEAD = """\
# The files of a run, field by field

{mark}

Version {version} of the format. `journal.jsonl` holds what happened: one JSON object per line, ASCII, each
line ended by a plain newline. `frames.npy.gz` holds [what was measured](measurements.md) in each frame.

- The key `event` names the kind of the line; the other keys stand in the order given here.
- Numbers are rounded to {digits} significant digits. JSON has no NaN and no infinity:
  they are written as the texts `"NaN"`, `"Infinity"` and `"-Infinity"`.
- Keys of an object that maps names to values are sorted.
- Boxes are centre boxes `x, y, w, h` in pixels; the centre of the pixel in row 0, column 0 is (0, 0).
- Frames count from 0. A decision made in frame n takes effect in frame n + 1.
- A killed run leaves a journal without `run_ended`, and perhaps a truncated last line, which readers drop.
- Applying the decisions (`target_started` to `parted`) in order rebuilds the net of any
  frame.

| lines of `journal.jsonl` | about | events |
|---|---|---|
{rows}
| [What was measured](measurements.md) | `frames.npy.gz`, frame by frame | |
| [Inputs](inputs.md) | `inputs.jsonl`, and objects inside lines | |

## How the format changes

The field `journal` of the first line is the version of the format. A program reads its own version
alone.

- Events and fields are added without a new version. An added field has a default value, so that earlier files
  stay readable. An earlier program refuses a line that it does not know.
- No event or field is removed or renamed, and none gets another type, unit or meaning; one may get a further
  kind of value. If one must, the
  version goes up by one.
- A run of another version of the format is refused (exit code 4) with the program version that wrote it:
  install that one to read it.

`tests/journal/format_2.json` holds every event and field of the version. A [checkpoint](../resume.md) has a
format of its own."""


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, page_text in document_events().items():
        (FOLDER / file).write_text(page_text, encoding="utf-8")

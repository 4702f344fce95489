"""What was measured of each target over a run, as columns, read in one pass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.blocks import Block, Blocks
from bayesnet_track.journal.frame_columns import is_absent
from bayesnet_track.journal.metrics import NOT_SHOWN, FrameMetrics
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Course:
    """One target's frames, in order.

    Attributes:
        target: whom it is about.
        block: its rows, with the columns that were asked for.
        texts: of each column of texts the texts that its codes stand for.
    """

    target: str
    block: Block
    texts: Mapping[str, Sequence[str]]

    def __len__(self) -> int:
        return len(self.block)

    def part(self, start: int, end: int) -> Course:
        """The rows from `start` to before `end`."""
        columns = {name: column[..., start:end] for name, column in self.block.columns.items()}
        return Course(self.target, Block(self.block.frame[start:end], columns), self.texts)

    @property
    def frame(self) -> NDArray[np.int64]:
        """(N,) numbers of the frames."""
        return self.block.frame

    def numbers(self, name: str) -> Floats:
        """(N,) a column in double precision; see `Block.numbers`."""
        return self.block.numbers(name)

    def is_text(self, name: str, texts: Iterable[str]) -> NDArray[np.bool_]:
        """(N,) whether a column holds one of some texts."""
        chosen = np.array([text in texts for text in self.texts.get(name, ())], dtype=bool)
        return chosen[self.block.codes(name)] if len(self) else np.zeros(0, dtype=bool)

    @cached_property
    def is_gone(self) -> NDArray[np.bool_]:
        """(N,) whether the box does not show the target: it is lost, or hidden."""
        return self.is_text("status", NOT_SHOWN)

    def by_name(self, field: str) -> dict[str, tuple[NDArray[np.bool_], Floats]]:
        """Name -> in which rows (N,) it has a number, and the numbers; by the first row, then by name."""
        numbers = {
            name.partition("/")[2]: self.numbers(name)
            for name in sorted(self.block.columns)
            if name.startswith(f"{field}/")
        }
        present = {name: (~is_absent(column), column) for name, column in numbers.items()}
        some = [name for name, (is_there, _) in present.items() if is_there.any()]
        return {name: present[name] for name in sorted(some, key=lambda name: present[name][0].argmax())}


def courses(
    metrics: Sequence[FrameMetrics], names: Iterable[str], targets: Iterable[str] | None = None
) -> dict[str, Course]:
    """The courses of all targets, or of some, in the order in which they appear.

    Args:
        metrics: the run's, in the order of frames.
        names: the columns to read; see `Blocks`.
        targets: the ones that are wanted; of those without measurements an empty course.

    Raises:
        JournalError: a record is damaged.
    """
    wanted = frozenset(names)
    blocks = Blocks(metrics, wanted)
    parts: dict[str, list[Block]] = {} if targets is None else {target: [] for target in targets}
    for block in blocks:
        codes = block.codes("target")
        order = np.argsort(codes, kind="stable")
        present, starts = np.unique(codes[order], return_index=True)
        for code, rows in zip(present.tolist(), np.split(order, starts[1:]), strict=True):
            target = blocks.texts["target"].texts[code]
            if targets is not None and target not in parts:
                continue
            columns = {
                name: column[..., rows]
                for name, column in block.columns.items()
                if name in wanted or f"{name.partition('/')[0]}/" in wanted
            }
            parts.setdefault(target, []).append(Block(block.frame[rows].astype(np.int32), columns))
    texts = {name: column.texts for name, column in blocks.texts.items()}
    return {target: Course(target, blocks.joined(some), texts) for target, some in parts.items()}

"""Helpers of most cues: likelihoods of distances, penalties for size, blended references, many at once.

How a cue sharpens itself is in `bayesnet_track.numerics.log_weights`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

Reference = Mapping[str, NDArray[Any]]
"""What a cue remembers of its target, as arrays by name, so that it can be stored and compared."""

FLOOR = 0.02
"""Likelihood of an outlier as a share of the best possible one, where nothing else is said."""

SD_LOG_AREA, SD_LOG_ASPECT = 0.5, 0.4
"""Standard deviations of the logs of area ratio and aspect ratio, where nothing else is said."""


def floored(log_likelihood: Floats, floor: float = FLOOR) -> Floats:
    """log(floor + (1 - floor) L), at most 0: a mixture with an outlier of likelihood `floor`.

    >>> floored(np.array([0.0, -np.inf]), 0.5).round(3).tolist()
    [0.0, -0.693]
    """
    # Nothing overflows, so that np.logaddexp is not needed, which takes three times as long.
    mixed = np.log(floor + (1.0 - floor) * np.exp(log_likelihood))
    return np.asarray(np.minimum(mixed, 0.0))  # rounding may exceed a perfect 0


class ReferenceRows(Sequence[Reference]):
    """References of T targets that hold the same names with arrays of the same shapes.

    Args:
        columns: name -> (T, ...) array; they become read-only.

    >>> rows = ReferenceRows({"alpha": np.array([0.1, 0.2])})
    >>> len(rows), float(rows[1]["alpha"])
    (2, 0.2)
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self.columns = dict(columns)
        for array in self.columns.values():
            array.setflags(write=False)

    @staticmethod
    def of(references: Sequence[Reference]) -> Sequence[Reference]:
        """The same as rows, if they hold arrays of the same names, shapes and types; else as they are.

        References that hold nothing stay as they are: rows without columns would not know how many they are.
        """
        if isinstance(references, ReferenceRows) or not references or not references[0]:
            return references
        first, columns = references[0], dict[str, NDArray[Any]]()
        for reference in references[1:]:
            if reference.keys() != first.keys():
                return references
        for name in first:
            stacked = _stack([reference[name] for reference in references])
            if stacked is None:
                return references
            columns[name] = stacked
        return ReferenceRows(columns)

    @overload
    def __getitem__(self, index: int) -> Reference: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Reference]: ...

    def __getitem__(self, index: int | slice) -> Reference | Sequence[Reference]:
        if isinstance(index, slice):
            return ReferenceRows({name: array[index] for name, array in self.columns.items()})
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return {name: array[index, ...] for name, array in self.columns.items()}

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def extended(self, additions: Sequence[Reference]) -> ReferenceRows | None:
        """These, then others; None where these hold other names, shapes or types."""
        if not isinstance(additions, ReferenceRows) or not self._is_like(additions):
            return None
        columns = additions.columns
        return ReferenceRows(
            {name: np.concatenate([array, columns[name]]) for name, array in self.columns.items()}
        )

    @staticmethod
    def joined(first: Sequence[Reference], second: Sequence[Reference]) -> Sequence[Reference]:
        """References, then others."""
        together = first.extended(second) if isinstance(first, ReferenceRows) else None
        return ReferenceRows.of([*first, *second]) if together is None else together

    @staticmethod
    def some(references: Sequence[Reference], rows: NDArray[np.intp]) -> Sequence[Reference]:
        """The references of some rows."""
        if isinstance(references, ReferenceRows):
            return references.take(rows)
        return [references[row] for row in rows.tolist()]

    def _is_like(self, references: ReferenceRows) -> bool:
        columns, new_columns = self.columns, references.columns
        return columns.keys() == new_columns.keys() and all(
            new_columns[name].shape[1:] == array.shape[1:] and new_columns[name].dtype == array.dtype
            for name, array in columns.items()
        )

    def take(self, rows: NDArray[np.intp]) -> ReferenceRows:
        """Rows of some targets."""
        return ReferenceRows({name: array[rows] for name, array in self.columns.items()})

    def replaced(self, rows: NDArray[np.intp], replacements: ReferenceRows) -> ReferenceRows | None:
        """With others in some rows; None where these hold other names, shapes or types."""
        if not self._is_like(replacements):
            return None
        columns = {name: array.copy() for name, array in self.columns.items()}
        for name, array in columns.items():
            array[rows] = replacements.columns[name]
        return ReferenceRows(columns)


def _stack(arrays: Sequence[Any]) -> NDArray[Any] | None:
    """Arrays of the same shape and type as one; None of anything else, which a row would change."""
    first = arrays[0]
    for array in arrays:
        if type(array) is not np.ndarray or array.dtype == object:
            return None
        if array.shape != first.shape or array.dtype != first.dtype:
            return None
    return _row(first) if len(arrays) == 1 else np.array(arrays)


def _row(values: NDArray[Any]) -> NDArray[Any]:
    """An array as the only row; a part of a larger one is copied, which would be kept with it."""
    owner = values.base
    is_all = owner is None or (isinstance(owner, np.ndarray) and owner.nbytes == values.nbytes)
    return values[None] if is_all and values.flags.c_contiguous else np.array([values])


def column(references: Sequence[Reference], name: str, missing: float | None = None) -> NDArray[Any]:
    """(T, ...) what references hold under a name, else `missing`; rows and a single one are not copied.

    >>> column([{"alpha": np.array(0.1)}, {}], "alpha", 1.0).tolist()
    [0.1, 1.0]
    """
    if isinstance(references, ReferenceRows) and (missing is None or name in references.columns):
        return references.columns[name]
    if len(references) == 1 and name in references[0]:
        return np.asarray(references[0][name])[None]
    return np.array(
        [reference[name] if missing is None else reference.get(name, missing) for reference in references]
    )

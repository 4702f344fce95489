"""What an agent remembers of many targets, as arrays with a row for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.likelihoods import Reference


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
        """The same as rows, if they hold arrays of the same names, shapes and types; else as they are."""
        if isinstance(references, ReferenceRows) or not references:
            return references
        first = references[0]
        kinds = {name: _kind(values) for name, values in first.items()}
        for one in references:
            if one.keys() != kinds.keys() or any(
                kind is None or _kind(one[name]) != kind for name, kind in kinds.items()
            ):
                return references
        return ReferenceRows({name: np.array([one[name] for one in references]) for name in first})

    @overload
    def __getitem__(self, at: int) -> Reference: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Reference]: ...

    def __getitem__(self, at: int | slice) -> Reference | Sequence[Reference]:
        if isinstance(at, slice):
            return ReferenceRows({name: array[at] for name, array in self.columns.items()})
        if not -len(self) <= at < len(self):
            raise IndexError(at)
        return {name: array[at, ...] for name, array in self.columns.items()}

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def extended(self, others: Sequence[Reference]) -> ReferenceRows | None:
        """These, then others; None where these hold other names, shapes or types."""
        if not isinstance(others, ReferenceRows) or not self._is_like(others):
            return None
        more = others.columns
        return ReferenceRows({name: np.concatenate([one, more[name]]) for name, one in self.columns.items()})

    def _is_like(self, others: ReferenceRows) -> bool:
        own, new = self.columns, others.columns
        return own.keys() == new.keys() and all(
            new[name].shape[1:] == array.shape[1:] and new[name].dtype == array.dtype
            for name, array in own.items()
        )

    def take(self, rows: NDArray[np.intp]) -> ReferenceRows:
        """Those of some targets."""
        return ReferenceRows({name: array[rows] for name, array in self.columns.items()})

    def replaced(self, rows: NDArray[np.intp], others: ReferenceRows) -> ReferenceRows | None:
        """With others in some rows; None where these hold other names, shapes or types."""
        if not self._is_like(others):
            return None
        after = {name: array.copy() for name, array in self.columns.items()}
        for name, array in after.items():
            array[rows] = others.columns[name]
        return ReferenceRows(after)


def _kind(values: Any) -> tuple[tuple[int, ...], np.dtype[Any]] | None:
    """Shape and type of an array; None of anything else, which a row would change."""
    return (values.shape, values.dtype) if type(values) is np.ndarray and values.dtype != object else None


def column(references: Sequence[Reference], name: str, missing: float | None = None) -> NDArray[Any]:
    """(T, ...) what references hold under a name, else `missing`; rows and a single one are not copied.

    >>> column([{"alpha": np.array(0.1)}, {}], "alpha", 1.0).tolist()
    [0.1, 1.0]
    """
    if isinstance(references, ReferenceRows) and (missing is None or name in references.columns):
        return references.columns[name]
    if len(references) == 1 and name in references[0]:
        return np.asarray(references[0][name])[None]
    return np.array([one[name] if missing is None else one.get(name, missing) for one in references])

"""Arrays that several read: each is given a view that it cannot write into."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = TypeVar("Array")


def read_only(array: Array) -> Array:
    """A view that cannot be written into; the array itself stays as it is.

    >>> own = np.zeros(3)
    >>> read_only(own).flags.writeable, own.flags.writeable
    (False, True)
    """
    if not isinstance(array, np.ndarray) or not array.flags.writeable:
        return array
    view: Any = array.view()
    view.flags.writeable = False
    seen: Array = view
    return seen


def for_reading(array: NDArray[Any]) -> NDArray[Any]:
    """The array in C order, read-only, so that a kernel that reads it has one compiled version only."""
    return read_only(np.ascontiguousarray(array))


def seal(reference: Mapping[str, Any]) -> dict[str, Any]:
    """The names and read-only views of the arrays."""
    return {name: read_only(array) for name, array in reference.items()}


def shown(reference: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    """A reference as a cue is given it: it can change neither the names nor the arrays.

    Arrays that are read-only are the same objects, by which workers know them again.
    """
    for array in reference.values():
        if isinstance(array, np.ndarray) and array.flags.writeable:
            return MappingProxyType(seal(reference))
    return MappingProxyType(reference if isinstance(reference, dict) else dict(reference))

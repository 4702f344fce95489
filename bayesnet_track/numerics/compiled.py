"""Compilation of kernels with Numba, and their cache on disk.

They become part of the machine code. Numba's cache on disk knows the file of the kernel alone: without this a
kernel would be found there in its former form after a neighbour has changed.
"""

from __future__ import annotations

import hashlib
import pickle
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numpy.typing import NDArray

from bayesnet_track.numerics.compile_watch import WATCH, CacheWarning

OF_LIBRARIES = frozenset({"math", "numba", "numpy"})
"""Modules whose contents change with their version only, which Numba looks at."""


def fingerprint(kernel: Any) -> str:
    """A digest of a kernel's code, its settings, and all that it refers to, in whatever files.

    Args:
        kernel: a dispatcher of Numba's, or a plain function.
    """
    return hashlib.sha256(repr(_describe(kernel, ())).encode()).hexdigest()


def _describe(value: Any, callers: tuple[int, ...]) -> object:
    """Something whose `repr` differs whenever `value` would be compiled differently."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic | None):
        return type(value).__qualname__, repr(value)
    if isinstance(value, tuple | list):
        return type(value).__qualname__, [_describe(element, callers) for element in value]
    if isinstance(value, set | frozenset):
        return sorted(repr(_describe(element, callers)) for element in value)
    if isinstance(value, dict):
        return [(name, _describe(element, callers)) for name, element in sorted(value.items())]
    function = getattr(value, "py_func", value)
    if not isinstance(function, FunctionType):
        return getattr(value, "__qualname__", type(value).__qualname__)
    if id(function) in callers:  # it calls itself
        return function.__qualname__
    callers = (*callers, id(function))
    return (
        function.__qualname__,
        _code(function.__code__),
        [(name, _describe(element, callers)) for name, element in _globals(function)],
        [_describe(cell.cell_contents, callers) for cell in function.__closure__ or ()],
        _describe(_settings(value), callers),
    )


def _settings(kernel: Any) -> dict[str, Any]:
    """Settings that become part of the machine code."""
    settings = getattr(kernel, "targetoptions", {})
    return {name: value for name, value in settings.items() if name != "no_cfunc_wrapper"}


def _code(code: CodeType) -> object:
    constants = [
        _code(constant) if isinstance(constant, CodeType) else repr(constant) for constant in code.co_consts
    ]
    return code.co_code, code.co_names, constants


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _globals(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Objects that a function refers to by name, directly or in a module that it names."""
    names = sorted(set(_names(function.__code__)))
    for name in names:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        if not isinstance(value, ModuleType):
            yield name, value
        elif value.__name__.split(".")[0] not in OF_LIBRARIES:
            yield from (
                (f"{name}.{inner}", getattr(value, inner)) for inner in names if hasattr(value, inner)
            )


MARK = b"\nbayesnet_track sha256 "
SEAL_BYTES = len(MARK) + 32
STOP = b"."
"""The last byte of a pickle."""

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_rare: list[Callable[[], None]] = []
"""What `rehearsed` marks and no tracker of this process has called."""


def compiled(function: Kernel) -> Kernel:
    """`function` compiled in no-Python mode, serial, releasing the interpreter lock.

    Where the cache on disk cannot be written (read-only, full), it compiles in memory. What is damaged there
    is compiled anew, with a warning (`SealedFiles`), and so is a kernel when something that it refers to has
    changed, in this file or in another. A division by zero is infinite or NaN, of whole numbers 0; none
    raises.
    """
    return _compiled(function, False)


def compiled_summing(function: Kernel) -> Kernel:
    """Compile with leave to add up in another order: sums of floats may use vector instructions.

    The order is fixed when it is compiled, so that results are the same bits on the same type of machine.
    Nothing else is relaxed: NaN and infinities keep their meaning.
    """
    return _compiled(function, {"reassoc", "contract", "nsz"})


def compiled_fusing(function: Kernel) -> Kernel:
    """Compile with leave to round a product and a sum once instead of twice."""
    return _compiled(function, {"contract"})


def plain(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """`array` as float64, writable and in C order, so that a kernel has one compiled version only."""
    if array.dtype.char == "d" and array.flags.carray:
        return array
    return np.array(array, np.float64, order="C")


def _compiled(function: Kernel, relaxed: bool | set[str]) -> Kernel:
    if numba.config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1, to debug a kernel: it stays plain Python
        return function
    # A kernel that another one calls exists twice, alone and within the caller, and sums of the two may be
    # ordered differently. Which of them is called depends on what came from the cache, unless it is inlined.
    settings: dict[str, Any] = {
        "nogil": True,
        "fastmath": relaxed,
        "forceinline": True,
        "no_cfunc_wrapper": True,  # called from Python only; a tenth of the compilation
        "error_model": "numpy",  # a division that may raise keeps its loop from vector instructions
    }
    try:
        kernel: Any = numba.njit(cache=True, **settings)(function)
    except RuntimeError:  # Numba found no folder that it may write
        kernel = numba.njit(cache=False, **settings)(function)
    # Numba itself lets a full disk or a damaged file end the call that only wanted the kernel.
    cache = kernel._cache
    load, save = _at_best(cache.load_overload), _at_best(cache.save_overload)

    def load_or_begin(*arguments: Any) -> Any:
        overload = load(*arguments)
        if overload is None:
            WATCH.begins(function)
        return overload

    def save_at_the_end(*arguments: Any) -> Any:
        WATCH.ends(function)
        return save(*arguments)

    cache.load_overload, cache.save_overload = load_or_begin, save_at_the_end
    if hasattr(cache, "_index_key"):  # there is a folder for it
        cache._cache_file.__class__ = SealedFiles
        key_of = cache._index_key
        cache._index_key = lambda *arguments: (*key_of(*arguments), fingerprint(kernel))
    compiled_kernel: Kernel = kernel
    return compiled_kernel


def rehearsed(call: Callable[[], None]) -> Callable[[], None]:
    """Mark a function that calls those kernels of its module which only some frames need."""
    _rare.append(call)
    return call


def rehearse_rare_calls() -> None:
    """Call what is marked in the modules that are imported so far, once a process."""
    while _rare:
        _rare.pop()()


def _at_best(use: Callable[..., Any]) -> Callable[..., Any]:
    """`use` of a cache, with None for what cannot be used."""

    def tried(*arguments: Any) -> Any:
        try:
            return use(*arguments)
        except Exception:
            return None

    return tried


class SealedFiles(IndexDataCacheFile):  # type: ignore[misc,unused-ignore]
    """The index and the data of one kernel, with a digest behind each.

    Numba loads what lies there unchecked. With a changed bit it may end the process, or compute something
    else. The files stay as Numba writes and reads them: it does not look at what follows a pickle.
    """

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return data + _seal(data)

    def _load_index(self) -> Any:
        path, version = Path(self._index_path), pickle.dumps(self._version, protocol=-1)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return {}
        if not data.startswith(version) or _is_numbas(data):
            return {}
        content = unsealed(data[len(version) :])
        if content is None:
            _drop(path)
            return {}
        stamp, overloads = pickle.loads(content)
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        content = unsealed(path.read_bytes())
        if content is None:
            _drop(path)
            raise FileNotFoundError(str(path))  # as Numba takes it: compiled anew, and replaced
        return pickle.loads(content)


def _seal(data: bytes) -> bytes:
    """Seal that follows `data` in a file."""
    return MARK + sha256(data).digest()


def unsealed(data: bytes) -> bytes | None:
    """Content before the seal; None if it is not what was sealed.

    >>> unsealed(b"code" + _seal(b"code")), unsealed(b"c0de" + _seal(b"code")), unsealed(b"code")
    (b'code', None, None)
    """
    content = data[:-SEAL_BYTES]
    return content if data[-SEAL_BYTES:] == _seal(content) else None


def is_whole(path: Path) -> bool:
    """True if an index or data file is what was sealed, or was never sealed; raises OSError."""
    data, version = path.read_bytes(), pickle.dumps(numba.__version__, protocol=-1)
    if path.suffix == ".nbi":
        data = data.removeprefix(version)
    return unsealed(data) is not None or _is_numbas(data)


def _is_numbas(data: bytes) -> bool:
    """True if Numba alone has written it: such a file ends in its pickle."""
    return MARK not in data and data.endswith(STOP)


def _drop(path: Path) -> None:
    """Say that a file is damaged, and remove it."""
    warnings.warn(
        f"{path}: damaged, so its kernel is compiled anew and the file replaced", CacheWarning, stacklevel=2
    )
    with suppress(OSError):
        path.unlink()

"""Cues of one's own without a package: a Python file that declares ``CUE``, or a declaration in a program.

To load a file is to run its code, so that it is done only where a user names it. The module that it becomes
has a name made of its SHA-256: what worker processes are sent refers to it by that name, and they load the
same bytes (`pack_cue_files`, `unpack_cue_files`), whatever stands in the file by then.
"""

from __future__ import annotations

import pickle
import sys
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, replace
from hashlib import sha256
from os import PathLike, fspath
from pathlib import Path
from types import ModuleType
from typing import Any

from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue import (
    CUE_FILE_MODULE,
    ENTRY_POINT_GROUP,
    FAULTS,
    CueDeclaration,
    CueError,
    installed_cues,
    own_text_of,
    text_of,
)

VARIABLE = "CUE"
"""What a cue file calls its declaration."""

GivenCue = CueDeclaration | str | PathLike[str]
"""A cue of one's own: its declaration, or the path of a file that declares it."""

_loaded: dict[str, CueFile] = {}


@dataclass(frozen=True, eq=False)
class CueFile:
    """A cue file that was run.

    Attributes:
        path: as given.
        content: its bytes.
        declaration: its ``CUE``.
    """

    path: str
    content: bytes
    declaration: CueDeclaration

    @property
    def sha256(self) -> str:
        """Of its bytes, in hexadecimal."""
        return sha256(self.content).hexdigest()


def load_cue_file(path: str | PathLike[str]) -> CueFile:
    """Run a cue file, once for the same bytes.

    Raises:
        CueError: it cannot be read or run, or declares no cue; says where and what.
    """
    name = fspath(path)
    try:
        content = Path(name).read_bytes()
    except FileNotFoundError:
        raise CueError(f"{name}: no such cue file") from None
    except OSError as error:
        raise CueError(f"{name}: the cue file cannot be read: {error.strerror}") from error
    return _loaded_from(name, content)


def use_cue_file(path: str | PathLike[str]) -> CueFile:
    """Load a cue file and have its cue among the installed ones, in this process from now on.

    Raises:
        CueError: as `load_cue_file`; or another cue has its name.
    """
    file = load_cue_file(path)
    _check_name(file.declaration, file.path)
    plugins.give(ENTRY_POINT_GROUP, file.declaration)
    return file


def own_cues(cues: Iterable[GivenCue]) -> dict[str, CueDeclaration]:
    """Cues of one's own by name; files are run.

    Raises:
        CueError: a file cannot be loaded, two cues have one name, or one has the name of an installed cue.
    """
    declarations: dict[str, CueDeclaration] = {}
    for cue in [cues] if isinstance(cues, str | PathLike | CueDeclaration) else cues:
        if isinstance(cue, CueDeclaration):
            declaration, location = cue, "cues"
        elif isinstance(cue, str | PathLike):
            declaration, location = load_cue_file(cue).declaration, fspath(cue)
        else:
            raise CueError(
                f"cues: {type(cue).__name__}; allowed: a CueDeclaration, or the path of a cue file"
            )
        if declarations.get(declaration.name, declaration) is not declaration:
            raise CueError(f"{location}: two cues are called {declaration.name!r}; give one another name")
        _check_name(declaration, location)
        declarations[declaration.name] = declaration
    return declarations


def file_of(declaration: CueDeclaration) -> CueFile | None:
    """The cue file that a declaration comes from; None for any other."""
    return next((file for file in _loaded.values() if file.declaration is declaration), None)


def pack_cue_files() -> bytes:
    """All cue files of this process, for one that works for it; no bytes where there are none."""
    files = [(file.path, file.content) for file in _loaded.values()]
    return pickle.dumps(files) if files else b""


def unpack_cue_files(files: bytes) -> None:
    """Load the cue files that were packed."""
    for path, content in pickle.loads(files) if files else ():
        _loaded_from(path, content)


def _check_name(declaration: CueDeclaration, location: str) -> None:
    installed = installed_cues().get(declaration.name)
    if installed is None or installed is declaration:
        return
    file = file_of(installed)
    whose = "a built-in cue" if file is None else f"the cue of {file.path}"
    raise CueError(f"{location}: the cue {declaration.name!r} has the name of {whose}; give it another name")


def _loaded_from(path: str, content: bytes) -> CueFile:
    digest = sha256(content).hexdigest()
    cached = _loaded.get(digest)
    if cached is not None:
        return cached if cached.path == path else replace(cached, path=path)
    module = ModuleType(CUE_FILE_MODULE + digest[:16])
    module.__file__ = path
    sys.modules[module.__name__] = module
    try:
        exec(_compile(path, content), module.__dict__)
    except FAULTS as error:
        del sys.modules[module.__name__]
        if isinstance(error, CueError):
            raise
        lines = [
            entry.lineno for entry in traceback.extract_tb(error.__traceback__) if entry.filename == path
        ]
        location = f"{path}:{lines[-1]}" if lines else path
        raised = f"{type(error).__name__}: {own_text_of(error)}"
        raise CueError(f"{location}: the cue file cannot be loaded: it raised {raised}") from error
    declaration = getattr(module, VARIABLE, None)
    if not isinstance(declaration, CueDeclaration):
        del sys.modules[module.__name__]
        raise CueError(
            f"{path}: {_describe(declaration)}; needed: {VARIABLE} = CueDeclaration(name, make=...)"
        )
    file = CueFile(path, content, declaration)
    _loaded[digest] = file
    return file


def _compile(path: str, content: bytes) -> Any:
    try:
        return compile(content, path, "exec", dont_inherit=True)
    except SyntaxError as error:
        location = path if error.lineno is None else f"{path}:{error.lineno}:{error.offset or 1}"
        raise CueError(f"{location}: the cue file is not Python: {error.msg}") from error
    except ValueError as error:  # a zero byte
        raise CueError(f"{path}: the cue file is not Python: {text_of(error)}") from error


def _describe(declaration: Any) -> str:
    if declaration is None:
        return f"no {VARIABLE} in the cue file"
    return f"{VARIABLE} in the cue file is a {type(declaration).__name__}"

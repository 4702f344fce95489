"""Network files: tried in a process of their own, as a damaged file may crash who loads it.

OpenCV and ONNX Runtime read such files in C++, where a changed byte can end the process. What was loaded and
run once elsewhere without that is loaded here. It is tried once for the same bytes, settings and libraries:
that it went well is kept beside the compiled kernels, where a folder for that can be written.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.observation.child import cut, python, tie

SECONDS = 120.0
"""Of loading and running a network once; a damaged one may go on for ever."""
CODE = f"from {__name__} import serve; serve()"

_tried: set[str] = set()
_announce: list[Callable[[str], object]] = []


def check_apart(
    load: Callable[..., object], files: Sequence[str], fault: Callable[[str], Exception], **given: Any
) -> None:
    """Call `load` with what is `given`, values of JSON, in another process, and refuse what ends that.

    Args:
        load: a function of a module that loads and runs networks; what it raises itself is no crash.
        files: paths of the networks.
        fault: makes of a text the exception to raise.
        given: arguments of `load`.

    Raises what `fault` makes: the process crashed, or took longer than `SECONDS`.
    """
    try:
        digests = {path: sha256(Path(path).read_bytes()).hexdigest() for path in files}
    except OSError:
        return  # `load` says so
    by_content = [digests.get(value, value) if isinstance(value, str) else value for value in given.values()]
    asked = [load.__module__, load.__qualname__, by_content, list(digests.values()), _versions()]
    key = sha256(json.dumps(asked).encode()).hexdigest()
    kept = _folder() / f"{key[:40]}.tried"
    if key in _tried or kept.exists():
        return
    ended, file = _try(json.dumps([load.__module__, load.__qualname__, given]))
    if ended is not None:
        raise fault(
            f"{file or ', '.join(files)}: {ended} where the network was tried: the file is damaged, or this "
            "library cannot run it; fetch it again, or export it anew"
        )
    _tried.add(key)
    with suppress(OSError):
        kept.parent.mkdir(exist_ok=True)
        kept.touch()


def working_on(path: str) -> None:
    """Note, where networks are tried, which file comes next: it is named if that ends the process."""
    for announce in _announce:
        announce(path)


def serve() -> None:
    """In the other process: call the function that the last argument names."""
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    module, name, given = json.loads(sys.argv[-1])
    _announce.append(lambda path: _say(file=path))
    load = getattr(import_module(module), name)
    _say(begins=True)
    try:
        load(**given)
    except Exception as error:
        if not type(error).__module__.startswith("bayesnet_track"):
            _say(raised=f"{type(error).__name__}: {error}"[:200])
    os._exit(0)  # what a damaged network left behind may crash when it is taken down


def _say(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def _try(asked: str) -> tuple[str | None, str]:
    """End of the other process in words, None where it went well; the last file it named."""
    environment = {**os.environ, "MALLOC_PERTURB_": "165"}  # what is read after it was freed is seen
    held, lifeline = tie()
    try:
        done = subprocess.run(
            python(CODE, asked, held=held),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=() if held < 0 else (held,),
            env=environment,
            timeout=SECONDS,
        )
        code: int | None = done.returncode
        output = done.stdout
    except subprocess.TimeoutExpired as error:
        code, output = None, error.stdout or b""
    except OSError:  # no process can be started: then it is loaded as it is
        return None, ""
    finally:
        cut(held, lifeline)
    said: dict[str, Any] = {}
    for line in output.decode("utf-8", "replace").splitlines():
        with suppress(ValueError):
            said |= json.loads(line)
    file = str(said.get("file", ""))
    if "raised" in said:
        return f"{said['raised']}, raised", file
    if code == 0 or "begins" not in said:  # it did not come to the network
        return None, file
    if code is None:
        return f"no end after {SECONDS:g} s", file
    return f"a crash ({signal.Signals(-code).name if code < 0 else f'exit code {code}'})", file


def _versions() -> list[str]:
    import cv2

    found = [platform.machine(), platform.python_version(), np.__version__, cv2.__version__]
    for name in ("bayesnet-track", "onnxruntime"):
        with suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    return found


def _folder() -> Path:
    """Folder of the compiled kernels, too."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    return Path(given) if given else Path(__file__).parent / "__pycache__"


def reason_of(error: Exception) -> str:
    """OpenCV's own words, without its file and line, in at most 200 characters.

    >>> reason_of(ValueError("OpenCV(4.12.0) net.cpp:3: error: (-215) no\\n such layer"))
    '(-215) no such layer'
    """
    return " ".join(str(error).split("error: ", 1)[-1].split())[:200]


def read_onnx(path: str, fault: Callable[[str], Exception]) -> Any:
    """OpenCV's network of an ONNX file; raises what `fault` makes of the text that says what is wrong."""
    import cv2

    try:
        model = np.fromfile(path, np.uint8)
    except OSError as error:
        raise fault(f"{path}: {error.strerror}") from error
    try:
        return cv2.dnn.readNetFromONNX(model)
    except cv2.error as error:
        raise fault(f"{path}: OpenCV cannot read it as an ONNX model: {reason_of(error)}") from error

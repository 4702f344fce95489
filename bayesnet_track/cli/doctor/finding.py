"""What a check finds, and how Python code is tried out where its failure can do no harm."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "note", "broken"]


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes:
        check: what was looked at.
        level: `ok`, `note` (works, but worth knowing) or `broken`.
        text: what was found.
        cure: what to do about it; empty when nothing needs to be done.
    """

    check: str
    level: Level
    text: str
    cure: str = ""


@dataclass(frozen=True)
class Trial:
    """How a piece of code ended in a process of its own.

    Attributes:
        out: what it printed.
        error: empty if it ended well, else the last line that it complained of.
        text: all that it complained of.
    """

    out: str
    error: str
    text: str


def try_code(code: str, *arguments: str, timeout_s: float = 60.0) -> Trial:
    """Run `code` in a process of its own: a library that crashes or hangs there leaves this one alone."""
    line = [sys.executable, "-P", "-c", code, *arguments]
    # The folder that this package came from, so that the other process finds the same one.
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8", "PYTHONPATH": os.pathsep.join(_path())}
    try:
        done = subprocess.run(
            line, capture_output=True, timeout=timeout_s, env=environment, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        late = f"no answer within {timeout_s:.0f} s"
        return Trial("", late, late)
    except OSError as error:
        return Trial("", str(error), str(error))
    out = done.stdout.decode("utf-8", "replace").strip()
    text = done.stderr.decode("utf-8", "replace").strip()
    if done.returncode == 0:
        return Trial(out, "", text)
    last = text.splitlines()[-1] if text else ""
    if done.returncode < 0:
        last = f"the process died of signal {-done.returncode}" + (f" after: {last}" if last else "")
    return Trial(out, last or f"exit code {done.returncode}", text)


def _path() -> list[str]:
    return [folder for folder in sys.path if folder]


def judge(check: str, trial: Trial, works: str, cure: str, broken: str = "") -> Finding:
    """`works` where the trial did; else its error after `broken`, and the cure."""
    if trial.error:
        return Finding(check, "broken", broken + trial.error, cure)
    return Finding(check, "ok", works)

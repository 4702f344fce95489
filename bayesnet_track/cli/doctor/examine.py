"""The command `doctor`: all checks in turn, each on its own, and what they found as text or JSON."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict

from bayesnet_track.cli.doctor import libraries, machine, own_paths, packages, selftest
from bayesnet_track.cli.doctor.finding import Finding

CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    packages.check_python,
    packages.check_system,
    packages.check_this_package,
    packages.check_versions,
    packages.check_wheels,
    libraries.check_numpy,
    libraries.check_opencv,
    libraries.check_numba,
    libraries.check_av,
    own_paths.check_video,
    own_paths.check_kernel,
    selftest.check_plugins,
    machine.check_cache,
    machine.check_folders,
    machine.check_processors,
    machine.check_clock,
    packages.check_extras,
    own_paths.check_cue,
    selftest.check_tracking,
    own_paths.check_worker,
)

MARKS = {"ok": "ok     ", "note": "note   ", "broken": "BROKEN "}


def examine(
    checks: Iterable[Callable[[], Iterator[Finding]]] = CHECKS,
) -> Iterator[Finding]:
    """Everything that the checks find; a check that fails itself is a finding, too."""
    for check in checks:
        try:
            yield from check()
        except Exception as error:
            name = check.__name__.removeprefix("check_").replace("_", " ")
            yield Finding(name, "broken", f"cannot be checked: {type(error).__name__}: {error}")


def doctor(options: Namespace) -> int:
    """Check the installation; exit code 1 when something is broken."""
    broken = 0
    found = []
    for finding in examine():
        broken += finding.level == "broken"
        if options.json:
            found.append(asdict(finding))
            continue
        sys.stdout.write(f"{MARKS[finding.level]}{finding.check:13} {finding.text}\n")
        if finding.cure:
            sys.stdout.write(f"{'':21}→ {finding.cure}\n")
        sys.stdout.flush()
    if options.json:
        sys.stdout.write(json.dumps(found, indent=2, ensure_ascii=False) + "\n")
    else:
        summary = "1 thing is broken" if broken == 1 else f"{broken} things are broken"
        sys.stdout.write(f"{summary}: begin with the first one\n" if broken else "everything works\n")
    return 1 if broken else 0

"""How much memory this process has."""

from __future__ import annotations

from pathlib import Path


def own_bytes() -> int:
    """Address space of this process, bytes; on systems that do not tell, its largest resident size."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        return pages * resource.getpagesize()
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10

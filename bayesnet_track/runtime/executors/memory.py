"""How much memory this process has, and may have."""

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


def limit_memory(megabytes: int) -> None:
    """Let this process have so much above what it has now; 0 does not limit it."""
    if megabytes > 0:
        import resource

        limit = own_bytes() + (megabytes << 20)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

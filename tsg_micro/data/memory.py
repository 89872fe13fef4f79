"""How much memory there is."""

from __future__ import annotations

import contextlib
from pathlib import Path

__all__ = ["available_memory"]


def available_memory() -> int | None:
    """Memory, bytes, that the kernel says is available, or a container's limit if that is less; None if unknown."""
    found = []
    with contextlib.suppress(OSError):
        rows = (row.split() for row in Path("/proc/meminfo").read_text().splitlines())
        found += [1024 * int(row[1]) for row in rows if row[0] == "MemAvailable:"]
    for limit in ("memory.max", "memory/memory.limit_in_bytes"):
        with contextlib.suppress(OSError, ValueError):  # a group without limit says "max"
            found.append(int(Path("/sys/fs/cgroup", limit).read_text()))
    return min(found, default=None)

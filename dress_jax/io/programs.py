"""Compiled programs that a process no longer needs.

Every program that XLA compiles for the CPU holds dozens of memory maps until it is dropped. A
Linux process may have 65,530 of them (vm.max_map_count); beyond, the compiler crashes. Garments of
different sizes need programs of their own, so a process that drapes one after the other would get
there.
"""

from pathlib import Path

import jax

_MAPS = Path("/proc/self/maps")
_MANY_MAPS = 40_000


def drop_programs_when_many(limit: int = _MANY_MAPS) -> bool:
    """Drop all compiled programs where the process has many memory maps.

    Call it between garments. What is needed again is compiled again, or loaded from the cache.

    Args:
        limit: memory maps that are left alone.

    Returns:
        Whether programs were dropped; never where the system does not list its memory maps.
    """
    if not _MAPS.is_file() or len(_MAPS.read_text().splitlines()) <= limit:
        return False
    jax.clear_caches()
    return True

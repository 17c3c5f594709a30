"""How long a stage took, with compilation apart from the rest."""

import contextlib
import dataclasses
import time
from collections.abc import Iterator
from typing import Any

import jax

# Tracing, lowering and compiling, and the loading of compiled programs from the cache.
_COMPILE_EVENTS = "/jax/core/compile/"


@dataclasses.dataclass
class Seconds:
    """Wall-clock seconds; complete once the block of `stopwatch` has ended.

    Attributes:
        compile: spent on tracing and compiling JAX programs.
        run: everything else.
    """

    compile: float = 0.0
    run: float = 0.0

    @property
    def total(self) -> float:
        """Both together."""
        return self.compile + self.run


@contextlib.contextmanager
def stopwatch() -> Iterator[Seconds]:
    """Measure a block.

    Compile events may lie within one another (a jitted function that traces another one), so their
    union on the time line counts, not their sum.

    Yields:
        Seconds, filled in when the block ends, also by an error.
    """
    spans: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **kwargs: Any) -> None:
        del kwargs
        if event.startswith(_COMPILE_EVENTS):
            now = time.perf_counter()
            spans.append((now - duration_secs, now))

    seconds = Seconds()
    start = time.perf_counter()
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seconds
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
        seconds.compile = _union(spans)
        seconds.run = max(time.perf_counter() - start - seconds.compile, 0.0)


def _union(spans: list[tuple[float, float]]) -> float:
    """Length of the union of intervals."""
    total, reached = 0.0, float("-inf")
    for first, last in sorted(spans):
        total += max(last - max(first, reached), 0.0)
        reached = max(reached, last)
    return total

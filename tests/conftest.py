"""Every test runs in double precision and with explicit broadcasting."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


# A Linux process may map 65,530 pieces of memory (vm.max_map_count), and every compiled program
# holds several until it is dropped; beyond that, the compiler crashes.
_MAPPED = Path("/proc/self/maps")
_MANY_MAPPED = 20_000


@pytest.fixture(scope="module", autouse=True)
def few_compiled_programs():
    """Drop the programs of earlier modules before there are too many of them."""
    yield
    if _MAPPED.is_file() and len(_MAPPED.read_text().splitlines()) > _MANY_MAPPED:
        jax.clear_caches()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with trial data, or a skip where it is absent."""
    root = Path(os.environ.get("DRESS_JAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"trial data not found at {root}; set DRESS_JAX_DATA")
    return root

"""Every test runs in double precision and with explicit broadcasting."""

import os
from pathlib import Path

import jax
import pytest

from dress_jax.io.programs import drop_programs_when_many

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="module", autouse=True)
def few_compiled_programs():
    """Drop the programs of earlier modules before there are too many of them."""
    yield
    drop_programs_when_many()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with trial data, or a skip where it is absent."""
    root = Path(os.environ.get("DRESS_JAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"trial data not found at {root}; set DRESS_JAX_DATA")
    return root

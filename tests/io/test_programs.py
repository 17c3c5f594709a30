from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from dress_jax.io.programs import drop_programs_when_many


@pytest.mark.skipif(not Path("/proc/self/maps").is_file(), reason="no list of memory maps here")
def test_programs_are_dropped_above_the_limit_only():
    traces = []

    @jax.jit
    def double(x):
        traces.append(x)
        return 2.0 * x

    double(jnp.ones(3))
    assert not drop_programs_when_many(10**9)
    double(jnp.ones(3))
    assert len(traces) == 1
    assert drop_programs_when_many(0)
    assert double(jnp.ones(3))[0] == 2.0 and len(traces) == 2

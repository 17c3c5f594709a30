import jax
import jax.numpy as jnp
import pytest

from dress_jax.io import programs
from dress_jax.io.programs import drop_programs_when_many


@pytest.fixture
def maps(tmp_path, monkeypatch):
    """A list of ten memory maps, in place of the system's."""
    path = tmp_path / "maps"
    path.write_text("map\n" * 10)
    monkeypatch.setattr(programs, "_MAPS", path)
    return path


def test_programs_are_dropped_above_the_limit_only(maps):
    traces = []

    @jax.jit
    def double(x):
        traces.append(x)
        return 2.0 * x

    double(jnp.ones(3))
    assert not drop_programs_when_many(10)
    double(jnp.ones(3))
    assert len(traces) == 1
    assert drop_programs_when_many(9)
    assert double(jnp.ones(3))[0] == 2.0 and len(traces) == 2


def test_nothing_is_dropped_where_maps_are_not_listed(maps):
    maps.unlink()
    assert not drop_programs_when_many(0)

"""Start states with intersections, repaired where asked."""

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.energy.fabric import FABRICS
from dress_jax.geometry.intersection import count_intersections
from dress_jax.sim import make_simulation, static_solve
from dress_jax.sim.dressing import dress, repair_start
from dress_jax.solver import NewtonOptions
from tests.sim.dressing.dressing_scenes import arranged, person, tube

COTTON = FABRICS["cotton"]


@pytest.fixture(scope="module")
def skirt():
    """A tube around the trunk, put on."""
    body, faces = person("a")
    made, rest, _ = arranged(tube(top=105.0, bottom=62.0, half_width=26.0), 0.06)
    garment = dress(made, rest, body, faces, fabric=COTTON)
    return made, rest, garment, body, faces


def _knotted(positions, body):
    """Pushed into the body at one place, and a fold through itself at another."""
    broken = positions.copy()
    axis = np.array([body[:, 0].mean(), 0.0, body[:, 2].mean()])
    front = np.argsort(-positions[:, 2])[:4]
    broken[front] += 0.8 * (axis - positions[front]) * [1.0, 0.0, 1.0]
    hem = np.argsort(positions[:, 1] + 0.5 * np.abs(positions[:, 0]))[:6]
    broken[hem] = broken[hem][::-1]
    return broken


def test_a_knotted_start_is_refused_and_repaired(skirt):
    made, rest, garment, body, faces = skirt
    cloth = np.asarray(made.faces)
    broken = _knotted(garment.positions, body)
    counts = count_intersections(broken, cloth, body, faces)
    assert counts.self > 0 and counts.body > 0
    simulator, parameters = make_simulation(
        garment.cloth,
        garment.positions,
        rest,
        fabric=COTTON,
        body_vertices=body,
        body_faces=faces,
        pin_targets=garment.pin_targets,
        newton=NewtonOptions(iteration_limit=3),
    )
    with pytest.raises(InputError, match="repair_start"):
        static_solve(simulator, parameters, jnp.asarray(broken))
    repair = repair_start(made, rest, broken, body, faces, fabric=COTTON)
    assert repair.before == counts
    after = count_intersections(repair.garment.positions, cloth, body, faces)
    assert (after.self, after.body) == (0, 0)
    # It stays where it was: a tube that is put on, not one that has fallen off or turned around.
    assert repair.mean_displacement < 0.05
    drape = static_solve(simulator, parameters, jnp.asarray(repair.garment.positions))
    assert drape.report.intersection_free


def test_a_state_that_does_not_fit_is_refused(skirt):
    made, rest, garment, body, faces = skirt
    with pytest.raises(InputError, match="expected"):
        repair_start(made, rest, garment.positions[:-1], body, faces, fabric=COTTON)
    broken = garment.positions.copy()
    broken[3, 1] = np.nan
    with pytest.raises(InputError, match="row 3"):
        repair_start(made, rest, broken, body, faces, fabric=COTTON)
    aside = garment.positions + np.array([0.4, 0.0, 0.0])
    with pytest.raises(InputError, match="tube_front"):
        repair_start(made, rest, aside, body, faces, fabric=COTTON)

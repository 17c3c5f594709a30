import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import KINDS, contact_of, facing_sheets, with_pairs

from dress_jax.contact.friction import Friction, friction_blocks, friction_energy
from dress_jax.contact.potential import PairKind, contact_energy
from dress_jax.core.pytree import replace
from tests.central_differences import UNOPTIMIZED, check_energy_derivatives

KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
MU = jnp.asarray(0.4, jnp.float64)
SLIP = jnp.asarray(0.05, jnp.float64)
# Central differences with step 1e-6; the normal force contains the barrier's slope, whose own
# derivatives grow like inverse powers of the gap.
FINITE_DIFFERENCE = 1e-4
# Forces of order one; the normal is rounded by 1e-16 times the size of the table over the gap.
ROUNDING = 1e-13

force = jax.jit(jax.grad(friction_energy))
repulsion = jax.jit(jax.grad(contact_energy))


def _block_on_a_table():
    """One vertex above a large face: positions and contact."""
    positions = np.array([[0.2, 0.3, 0.2], [-5.0, 0, -5.0], [-5, 0, 9], [9, 0, -5]])
    contact = contact_of(np.arange(4)[:, None], np.ones(4), PairKind.VERTEX_FACE)
    return jnp.asarray(positions), contact


def _friction(start, contact, mu=MU):
    return Friction(contact, start, mu, SLIP)


@KIND
def test_derivatives(kind):
    """To second order in the end, the start, areas, stiffness and the coefficient."""
    start, contact = facing_sheets(kind)
    # Some pairs slide, some stick.
    end = start + 0.04 * jnp.asarray(np.random.default_rng(4).normal(size=start.shape))

    def value(end, start, areas, stiffness, mu):
        changed = replace(contact, areas=areas, barrier_stiffness=stiffness)
        return friction_energy(end, _friction(start, changed, mu))

    arguments = (end, start, contact.areas, contact.barrier_stiffness, MU)
    check_energy_derivatives(value, arguments, step=1e-6, tolerance=FINITE_DIFFERENCE)


@KIND
def test_no_force_at_rest(kind):
    """At rest there is no friction force, and its energy is a constant."""
    start, contact = facing_sheets(kind)
    gradient = force(start, _friction(start, contact))
    np.testing.assert_array_equal(gradient, 0.0)


def test_stiffness_at_rest():
    """The second derivative exists at rest, where the length of the slip has a kink."""
    start, contact = _block_on_a_table()
    push = repulsion(start, contact)
    hessian = jax.jit(jax.hessian(friction_energy))(start, _friction(start, contact))[0, :, 0]
    stiffness = 2.0 * float(MU) * -float(push[0, 1]) / float(SLIP)
    expected = stiffness * np.diag([1.0, 0.0, 1.0])
    np.testing.assert_allclose(hessian, expected, rtol=1e-12, atol=1e-12 * stiffness)


@pytest.mark.parametrize("slip", [0.01, 0.03, 0.05, 0.2])
@pytest.mark.parametrize("direction", [0.0, 2.2])
def test_force_of_a_sliding_block(slip, direction):
    """mu N against the slip once it exceeds the slip length, mu N (2 y - y^2) below it."""
    start, contact = _block_on_a_table()
    push = repulsion(start, contact)
    normal_force = -float(push[0, 1])
    assert normal_force > 0.1
    along = np.array([np.cos(direction), 0.0, np.sin(direction)])
    end = start.at[0].add(slip * along)
    f = -force(end, _friction(start, contact))
    y = min(slip / float(SLIP), 1.0)
    expected = -float(MU) * normal_force * (2.0 * y - y**2) * along
    np.testing.assert_allclose(f[0], expected, rtol=1e-12, atol=ROUNDING)
    np.testing.assert_allclose(f.sum(0), 0.0, atol=ROUNDING)  # the table takes the reaction


def test_normal_motion_has_no_friction():
    start, contact = _block_on_a_table()
    end = start.at[0, 1].add(0.4)
    f = force(end, _friction(start, contact))
    np.testing.assert_allclose(f, 0.0, atol=ROUNDING)


@KIND
def test_common_motion_has_no_friction(kind):
    """Both sheets moved by the same translation do not slip."""
    start, contact = facing_sheets(kind)
    end = start + jnp.asarray([[0.3, -0.1, 0.2]])
    f = force(end, _friction(start, contact))
    scale = float(MU) * np.abs(repulsion(start, contact)).max()
    np.testing.assert_allclose(f, 0.0, atol=1e-11 * scale)


@KIND
def test_switched_off_and_padding(kind):
    start, contact = facing_sheets(kind)
    end = start + 0.04 * jnp.asarray(np.random.default_rng(5).normal(size=start.shape))
    none = with_pairs(contact, count=0 * contact.pairs.count)
    assert not np.any(force(end, _friction(start, contact, 0.0 * MU)))
    assert not np.any(force(end, _friction(start, none)))
    few = with_pairs(contact, count=contact.pairs.count - 30)
    # Pairs of a vertex with itself, beyond the count.
    other = with_pairs(few, indices=contact.pairs.indices.at[:, -30:].set(0))
    np.testing.assert_array_equal(
        force(end, _friction(start, other)), force(end, _friction(start, few))
    )


@KIND
def test_blocks_are_a_positive_semidefinite_bound(kind):
    """s w_p w_q (I - n n^T) equals the Hessian across the slip and exceeds it along the slip."""
    start, contact = facing_sheets(kind)
    end = start + 0.04 * jnp.asarray(np.random.default_rng(6).normal(size=start.shape))
    friction = _friction(start, contact)
    weights, normal, stiffness = friction_blocks(end, friction)
    assert np.all(np.asarray(stiffness) >= 0.0) and np.any(np.asarray(stiffness) > 0.0)
    n = np.array(normal)
    tangent = np.eye(3)[:, :, None] - n[:, None] * n[None]
    blocks = np.einsum("m,pm,qm,ijm->mpiqj", stiffness, weights, weights, tangent)
    size = len(start)
    dense = np.zeros((size, 3, size, 3))
    for m, stencil in enumerate(np.asarray(contact.pairs.indices).T):
        for p in range(4):
            for q in range(4):
                dense[stencil[p], :, stencil[q]] += blocks[m, p, :, q]
    dense = dense.reshape(3 * size, 3 * size)
    hessian = jax.hessian(friction_energy)
    exact = jax.jit(hessian, compiler_options=UNOPTIMIZED)(end, friction)
    exact = np.asarray(exact).reshape(3 * size, 3 * size)
    scale = np.linalg.norm(dense, 2)
    assert np.linalg.eigvalsh(dense)[0] > -1e-12 * scale
    assert np.linalg.eigvalsh(dense - exact)[0] > -1e-12 * scale
    assert np.linalg.norm(exact, 2) > 0.1 * scale

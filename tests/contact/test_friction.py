import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import KINDS, SETTINGS, STIFFNESS, facing_sheets

from dress_jax.contact.friction import friction_blocks, friction_energy
from dress_jax.contact.potential import PairKind, contact_energy
from tests.central_differences import UNOPTIMIZED, check_energy_derivatives

KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
MU = jnp.asarray(0.4, jnp.float64)
SLIP = jnp.asarray(0.05, jnp.float64)
# Central differences with step 1e-6; the normal force contains the barrier's slope, whose own
# derivatives grow like inverse powers of the gap.
FINITE_DIFFERENCE = 1e-4
# Forces of order one; the normal is rounded by 1e-16 times the size of the table over the gap.
ROUNDING = 1e-13

energy = jax.jit(friction_energy, static_argnames="kind")
force = jax.jit(jax.grad(friction_energy), static_argnames="kind")
repulsion = jax.jit(jax.grad(contact_energy), static_argnames="kind")


def _block_on_a_table():
    """One vertex above a large face: positions, areas, pairs, count."""
    positions = np.array([[0.2, 0.3, 0.2], [-5.0, 0, -5.0], [-5, 0, 9], [9, 0, -5]])
    return (
        jnp.asarray(positions),
        jnp.ones(4),
        jnp.arange(4)[:, None],
        jnp.asarray(1),
    )


def _arguments(start, areas, pairs, count, mu=MU):
    return start, areas, pairs, count, STIFFNESS, mu, SLIP, SETTINGS


@KIND
def test_derivatives(kind):
    """To second order in the end, the start, areas, stiffness and the coefficient."""
    start, areas, pairs, count = facing_sheets(kind)
    # Some pairs slide, some stick.
    end = start + 0.04 * jnp.asarray(np.random.default_rng(4).normal(size=start.shape))

    def value(end, start, areas, stiffness, mu):
        return friction_energy(
            end, start, areas, pairs, count, stiffness, mu, SLIP, SETTINGS, kind=kind
        )

    arguments = (end, start, areas, STIFFNESS, MU)
    check_energy_derivatives(value, arguments, step=1e-6, tolerance=FINITE_DIFFERENCE)


@KIND
def test_no_force_at_rest(kind):
    """At rest there is no friction force, and its energy is a constant."""
    start, areas, pairs, count = facing_sheets(kind)
    gradient = force(start, *_arguments(start, areas, pairs, count), kind=kind)
    np.testing.assert_array_equal(gradient, 0.0)


def test_stiffness_at_rest():
    """The second derivative exists at rest, where the length of the slip has a kink."""
    start, areas, pairs, count = _block_on_a_table()
    push = repulsion(start, areas, pairs, count, STIFFNESS, SETTINGS, kind=PairKind.VERTEX_FACE)
    arguments = _arguments(start, areas, pairs, count)
    hessian = jax.jit(
        jax.hessian(lambda x: friction_energy(x, *arguments, kind=PairKind.VERTEX_FACE))
    )(start)[0, :, 0]
    stiffness = 2.0 * float(MU) * -float(push[0, 1]) / float(SLIP)
    expected = stiffness * np.diag([1.0, 0.0, 1.0])
    np.testing.assert_allclose(hessian, expected, rtol=1e-12, atol=1e-12 * stiffness)


@pytest.mark.parametrize("slip", [0.01, 0.03, 0.05, 0.2])
@pytest.mark.parametrize("direction", [0.0, 2.2])
def test_force_of_a_sliding_block(slip, direction):
    """mu N against the slip once it exceeds the slip length, mu N (2 y - y^2) below it."""
    start, areas, pairs, count = _block_on_a_table()
    push = repulsion(start, areas, pairs, count, STIFFNESS, SETTINGS, kind=PairKind.VERTEX_FACE)
    normal_force = -float(push[0, 1])
    assert normal_force > 0.1
    along = np.array([np.cos(direction), 0.0, np.sin(direction)])
    end = start.at[0].add(slip * along)
    f = -force(end, *_arguments(start, areas, pairs, count), kind=PairKind.VERTEX_FACE)
    y = min(slip / float(SLIP), 1.0)
    expected = -float(MU) * normal_force * (2.0 * y - y**2) * along
    np.testing.assert_allclose(f[0], expected, rtol=1e-12, atol=ROUNDING)
    np.testing.assert_allclose(f.sum(0), 0.0, atol=ROUNDING)  # the table takes the reaction


def test_normal_motion_has_no_friction():
    start, areas, pairs, count = _block_on_a_table()
    end = start.at[0, 1].add(0.4)
    f = force(end, *_arguments(start, areas, pairs, count), kind=PairKind.VERTEX_FACE)
    np.testing.assert_allclose(f, 0.0, atol=ROUNDING)


@KIND
def test_common_motion_has_no_friction(kind):
    """Both sheets moved by the same translation do not slip."""
    start, areas, pairs, count = facing_sheets(kind)
    end = start + jnp.asarray([[0.3, -0.1, 0.2]])
    f = force(end, *_arguments(start, areas, pairs, count), kind=kind)
    scale = (
        float(MU)
        * np.abs(repulsion(start, areas, pairs, count, STIFFNESS, SETTINGS, kind=kind)).max()
    )
    np.testing.assert_allclose(f, 0.0, atol=1e-11 * scale)


@KIND
def test_switched_off_and_padding(kind):
    start, areas, pairs, count = facing_sheets(kind)
    end = start + 0.04 * jnp.asarray(np.random.default_rng(5).normal(size=start.shape))
    assert not np.any(force(end, *_arguments(start, areas, pairs, count, 0.0 * MU), kind=kind))
    assert not np.any(force(end, *_arguments(start, areas, pairs, 0 * count), kind=kind))
    few = count - 30
    other = pairs.at[:, -30:].set(0)  # pairs of a vertex with itself, beyond the count
    np.testing.assert_array_equal(
        force(end, *_arguments(start, areas, other, few), kind=kind),
        force(end, *_arguments(start, areas, pairs, few), kind=kind),
    )


@KIND
def test_blocks_are_a_positive_semidefinite_bound(kind):
    """s w_p w_q (I - n n^T) equals the Hessian across the slip and exceeds it along the slip."""
    start, areas, pairs, count = facing_sheets(kind)
    end = start + 0.04 * jnp.asarray(np.random.default_rng(6).normal(size=start.shape))
    arguments = _arguments(start, areas, pairs, count)
    weights, normal, stiffness = friction_blocks(end, *arguments, kind=kind)
    assert np.all(np.asarray(stiffness) >= 0.0) and np.any(np.asarray(stiffness) > 0.0)
    n = np.array(normal)
    tangent = np.eye(3)[:, :, None] - n[:, None] * n[None]
    blocks = np.einsum("m,pm,qm,ijm->mpiqj", stiffness, weights, weights, tangent)
    size = len(start)
    dense = np.zeros((size, 3, size, 3))
    for m, stencil in enumerate(np.asarray(pairs).T):
        for p in range(4):
            for q in range(4):
                dense[stencil[p], :, stencil[q]] += blocks[m, p, :, q]
    dense = dense.reshape(3 * size, 3 * size)
    hessian = jax.hessian(lambda x: friction_energy(x, *arguments, kind=kind))
    exact = jax.jit(hessian, compiler_options=UNOPTIMIZED)(end)
    exact = np.asarray(exact).reshape(3 * size, 3 * size)
    scale = np.linalg.norm(dense, 2)
    assert np.linalg.eigvalsh(dense)[0] > -1e-12 * scale
    assert np.linalg.eigvalsh(dense - exact)[0] > -1e-12 * scale
    assert np.linalg.norm(exact, 2) > 0.1 * scale

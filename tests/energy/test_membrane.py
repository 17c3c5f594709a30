import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_scenes import columns, rotation, stretched_triangles

from dress_jax.core import components as c
from dress_jax.energy.membrane import (
    TRIANGLE_PAIRS,
    MembraneModel,
    deformation_gradient,
    density,
    membrane_blocks,
    membrane_energy,
    membrane_frame,
    principal_stretches,
)
from dress_jax.energy.rest import RestTriangles, rest_triangles

ISOTROPIC = (MembraneModel.ARAP, MembraneModel.NEO_HOOKEAN)
MODELS = pytest.mark.parametrize("model", ISOTROPIC, ids=lambda model: model.value)
NU = 0.3
STIFFNESS = 1.7

# Larger and smaller stretch of each test triangle.
STRETCHES = np.array(
    [
        [1.0, 1.0],  # rest
        [1.2, 0.9],  # ordinary
        [1.1, 1.1],  # equal singular values
        [0.6, 0.6],  # equal and compressed: the frame is not unique
        [1.0 + 1e-9, 1.0],  # all but equal
        [0.7, 0.4],  # compressed: indefinite before projection
        [1.6, 0.5],  # sheared (a stretch along a diagonal)
        [2.5, 1.8],  # far stretched: logarithmic stiffening of the neo-Hookean model
        [1.3, 1e-3],  # nearly a line
    ]
)
# The nearly degenerate triangle has curvatures d/s2 of 1e3 to 1e6, and autodiff of sqrt(J^2)
# loses as many digits; all others agree to 1e-12.
HESSIAN_RELATIVE = 1e-8
ROUNDING = 1e-13


def _energy(model, positions, faces, rest, stiffness=STIFFNESS):
    return membrane_energy(
        columns(positions), jnp.asarray(faces), rest, jnp.asarray(stiffness), jnp.asarray(NU), model
    )


def closed_form(model, s1, s2):
    """Density over k_s in the principal stretches."""
    if model is MembraneModel.ARAP:
        return (s1 - 1.0) ** 2 + (s2 - 1.0) ** 2
    # mu and lambda of plane stress, for E = 1.
    mu, lame = 1.0 / (2.0 * (1.0 + NU)), NU / (1.0 - NU**2)
    log = np.log(s1 * s2)
    return 0.5 * (s1**2 + s2**2 - 2.0 - 2.0 * log) + 0.5 * lame / mu * log**2


@MODELS
def test_energy_in_the_principal_stretches(model):
    positions, faces, rest, _ = stretched_triangles(STRETCHES)
    expected = STIFFNESS * np.asarray(rest.areas) * closed_form(model, *STRETCHES.T)
    for k in range(len(STRETCHES)):
        one = jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], rest)
        value = _energy(model, positions, faces[:, k : k + 1], one)
        # Near rest the density is a difference of numbers of order one.
        np.testing.assert_allclose(value, expected[k], rtol=1e-10, atol=1e-14)
    larger, smaller = principal_stretches(jnp.asarray(positions), jnp.asarray(faces), rest)
    np.testing.assert_allclose(np.stack([larger, smaller], 1), STRETCHES, rtol=1e-8)


@MODELS
def test_no_energy_and_no_force_under_rigid_motion(model):
    positions, faces, rest, _ = stretched_triangles(np.ones((4, 2)))
    rng = np.random.default_rng(3)
    moved = positions @ rotation(rng).T + rng.normal(size=3)
    value, gradient = jax.value_and_grad(
        lambda x: membrane_energy(
            c.split(x), jnp.asarray(faces), rest, jnp.asarray(1.0), jnp.asarray(NU), model
        )
    )(jnp.asarray(moved))
    np.testing.assert_allclose(value, 0.0, atol=ROUNDING)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-12)


@MODELS
def test_both_models_have_the_same_shear_modulus(model):
    """A traceless small strain costs k_s A 2 e^2 whatever the Poisson ratio."""
    strain = 1e-4
    positions, faces, rest, _ = stretched_triangles(np.array([[1.0 + strain, 1.0 - strain]]))
    expected = STIFFNESS * float(rest.areas[0]) * 2.0 * strain**2
    # The next term of the series is smaller by the strain; rounding is 1e-16 / strain^2.
    np.testing.assert_allclose(_energy(model, positions, faces, rest), expected, rtol=1e-3)


def _element_energy(points, inverse, area, model):
    """The energy of one triangle as a function of its nine coordinates."""
    rest = RestTriangles(inverse=inverse, areas=area)
    corners = tuple(tuple(points[p, k] for k in range(3)) for p in range(3))
    f1, f2 = deformation_gradient(corners, rest)
    return STIFFNESS * area * density(model, f1, f2, jnp.asarray(NU))


def _matrices(positions, faces, rest, model, project):
    """The package's blocks as full element matrices (f, 9, 9)."""
    frame = membrane_frame(
        columns(positions),
        jnp.asarray(faces),
        rest,
        jnp.asarray(STIFFNESS),
        jnp.asarray(NU),
        model,
        project=project,
    )
    first, second = np.array(TRIANGLE_PAIRS).T
    rows = jax.tree.map(lambda leaf: leaf[None] if leaf.ndim == 1 else leaf, frame)
    blocks = membrane_blocks(
        rows, (frame.alpha[first], frame.alpha[second]), (frame.beta[first], frame.beta[second])
    )
    blocks = np.array(blocks)  # (3, 3, pairs, f)
    out = np.zeros((faces.shape[1], 3, 3, 3, 3))
    for k, (p, q) in enumerate(TRIANGLE_PAIRS):
        out[:, p, :, q, :] = blocks[:, :, k].transpose(2, 0, 1)
        out[:, q, :, p, :] = blocks[:, :, k].transpose(2, 1, 0)
    return out.reshape(-1, 9, 9)


def _compare(actual, expected):
    scale = np.linalg.norm(expected, axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(actual / scale, expected / scale, rtol=0, atol=HESSIAN_RELATIVE)


@MODELS
def test_blocks_against_autodiff(model):
    positions, faces, rest, _ = stretched_triangles(STRETCHES)
    points = jnp.asarray(positions).reshape(-1, 3, 3)
    hessian = jax.jit(jax.vmap(jax.hessian(lambda x, i, a: _element_energy(x, i, a, model))))
    expected = np.asarray(hessian(points, rest.inverse, rest.areas)).reshape(-1, 9, 9)
    exact = _matrices(positions, faces, rest, model, project=False)
    _compare(exact, expected)
    assert np.linalg.eigvalsh(expected[5])[0] < -0.1  # the compressed triangle is indefinite


@MODELS
def test_projected_blocks_against_an_eigendecomposition(model):
    """The clamped Hessian in the deformation gradient, mapped to the vertices.

    The projection acts on the 6x6 Hessian in F; an eigenvalue clamp of the 9x9 matrix would be
    another, equally valid, projection.
    """
    positions, faces, rest, _ = stretched_triangles(STRETCHES)
    gradients = np.array(
        deformation_gradient(
            tuple(c.gather(columns(positions), jnp.asarray(faces[k])) for k in range(3)), rest
        )
    ).transpose(2, 0, 1)

    def of_gradient(f):
        return density(model, tuple(f[0]), tuple(f[1]), jnp.asarray(NU))

    hessian = jax.jit(jax.vmap(jax.hessian(of_gradient)))(jnp.asarray(gradients))
    values, vectors = np.linalg.eigh(np.asarray(hessian).reshape(-1, 6, 6))
    clamped = np.einsum("fij,fj,fkj->fik", vectors, np.maximum(values, 0.0), vectors)
    i00, i01, i10, i11 = np.asarray(rest.inverse)
    shape = np.array([[-i00 - i10, -i01 - i11], [i00, i01], [i10, i11]])  # (corner, column, f)
    to_gradient = np.einsum("pcf,ij->fcipj", shape, np.eye(3)).reshape(-1, 6, 9)
    scale = STIFFNESS * np.asarray(rest.areas)
    expected = scale[:, None, None] * (to_gradient.transpose(0, 2, 1) @ clamped @ to_gradient)

    projected = _matrices(positions, faces, rest, model, project=True)
    _compare(projected, expected)
    smallest = np.linalg.eigvalsh(projected)[:, 0]
    assert np.all(smallest >= -1e-12 * np.linalg.norm(projected, axis=(1, 2)))


def test_arap_force_is_finite_on_a_collapsed_triangle():
    """Three corners on a line: the area has a kink there, the force must still be a number."""
    rest = rest_triangles(jnp.array([[0.0, 0], [1, 0], [0, 1]]), jnp.array([[0], [1], [2]]))
    line = jnp.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    gradient = jax.grad(
        lambda x: membrane_energy(
            c.split(x),
            jnp.array([[0], [1], [2]]),
            rest,
            jnp.asarray(1.0),
            jnp.asarray(NU),
            MembraneModel.ARAP,
        )
    )(line)
    assert np.all(np.isfinite(gradient)) and np.any(gradient != 0.0)


def test_neo_hookean_energy_is_infinite_on_a_collapsed_triangle():
    rest = rest_triangles(jnp.array([[0.0, 0], [1, 0], [0, 1]]), jnp.array([[0], [1], [2]]))
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    value = _energy(MembraneModel.NEO_HOOKEAN, line, np.array([[0], [1], [2]]), rest)
    assert value == np.inf

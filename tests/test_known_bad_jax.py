"""A miscompilation of jax 0.10.2 on CPU that would silently corrupt positions.

A jitted, vmapped product of one shared 3x3 matrix with many rows, followed by a reduction, returns
wrong rows from a certain size on. pyproject.toml excludes that version; this holds every other.
"""

import ast
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dress_jax

# The first sizes at which 0.10.2 is wrong, in float64 and in float32.
FIRST_WRONG = {jnp.float64: 16_385, jnp.float32: 32_769}
# Releases that get the plain sum in float32 wrong, whatever instructions and cores the machine has;
# 0.8.0 and 0.9.0 are right.
WRONG_SUM = ("0.10.0", "0.10.1")

PACKAGE = Path(dress_jax.__file__).parent
COMPONENT_LAYERS = (
    "energy",
    "contact",
    "sim",
    "render",
    "loss",
    "optimisation",
    "reconstruction",
)
PRODUCTS = {"dot", "dot_general", "einsum", "inner", "matmul", "matvec", "tensordot", "vecmat"}
# On the host, by NumPy.
HOST_PRODUCTS = {("render/cameras.py", "rotation @ rotation.T")}


def _check(dtype, reduction):
    """Small integers, so that every product and sum is exact and nothing needs a tolerance."""
    rng = np.random.default_rng(0)
    x = rng.integers(-30, 30, (FIRST_WRONG[dtype], 3))
    matrix = np.array([[2, 0, 1], [0, 1, 0], [-1, 0, 3]])
    shared = jnp.asarray(matrix, dtype)
    reduced = jax.jit(jax.vmap(lambda row: reduction(shared @ row)))(jnp.asarray(x, dtype))
    np.testing.assert_array_equal(np.asarray(reduced), [reduction(row) for row in x @ matrix.T])


@pytest.mark.parametrize("dtype", FIRST_WRONG, ids=["float64", "float32"])
def test_squared_norm_of_a_shared_matrix_times_rows(dtype):
    _check(dtype, lambda vector: (vector**2).sum())


def test_sum_of_a_shared_matrix_times_rows_in_float64():
    _check(jnp.float64, lambda vector: vector.sum())


def test_sum_of_a_shared_matrix_times_rows_in_float32():
    """A second case, wrong in releases that the package allows: see the next test.

    Their mistake is asserted, so that a release that mends it, or another that makes it, shows.
    """
    if jax.__version__ in WRONG_SUM:
        with pytest.raises(AssertionError, match="Arrays are not equal"):
            _check(jnp.float32, lambda vector: vector.sum())
    else:
        _check(jnp.float32, lambda vector: vector.sum())


def matrix_products(source: str) -> list[str]:
    """Products of matrices in a module that imports jax, as they are written."""
    found = []
    if not re.search(r"^(import|from) jax\b", source, re.MULTILINE):
        return found
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            found.append(ast.unparse(node))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            owner = ast.unparse(node.func.value)
            if node.func.attr in PRODUCTS and owner.split(".")[0] in ("jax", "jnp", "lax", "np"):
                found.append(ast.unparse(node))
    return found


def test_compiled_code_multiplies_no_rows_by_a_shared_matrix():
    """Whatever is compiled over vertices, pairs or pixels works on components.

    Of the other packages, `body`, `pattern` and `solver` compile products: with a matrix per vertex
    or joint, with matrices of many columns, and with a sparse one.
    """
    found = {
        (path.relative_to(PACKAGE).as_posix(), product)
        for layer in COMPONENT_LAYERS
        for path in (PACKAGE / layer).rglob("*.py")
        for product in matrix_products(path.read_text(encoding="utf-8"))
    }
    assert found == HOST_PRODUCTS


@pytest.mark.parametrize(
    "source",
    [
        "y = jax.vmap(lambda row: rotation @ row)(x)",
        "y = jnp.einsum('ij,nj->ni', rotation, x)",
        "y = jax.numpy.dot(x, rotation)",
        "y = lax.dot_general(x, rotation, dimension_numbers)",
    ],
)
def test_a_product_is_found(source):
    assert len(matrix_products(f"import jax\n{source}")) == 1


@pytest.mark.parametrize(
    "source", ["import jax\ny = c.dot(edge, edge) * scale", "import numpy as np\ny = x @ rotation"]
)
def test_components_and_host_code_are_left_alone(source):
    assert not matrix_products(source)

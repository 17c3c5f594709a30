"""The body: shape components, linear blend skinning and optional pose correctives.

    v_s = T + S b,   J = J_T + J_S b,   R_j = exp(pose_j),   v_s += P vec(R_1.. - I)
    v   = sum_j w_j (G_j.R (v_s - J_j) + G_j.t) + translation

with G_j the chain of R along the joint tree. One implementation serves the embedded body and
SMPL-X files (checklist S7.1); both have 55 joints in the order of `body.skeleton`.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.body.skeleton import depth_levels
from dress_jax.core.pytree import pytree, static

# Squared angle below which rotations use their series: its first dropped term is below 1e-16.
SERIES_BELOW = 1e-5


@pytree
class BodyModel:
    """A rigged body with j joints, n vertices, b shape components.

    Args:
        template: mean shape in the rest pose [m], shape (n, 3).
        shapedirs: displacement of one unit of each shape coefficient [m], shape (n, 3, b).
        posedirs: pose correctives [m], shape (n, 3, 9 (j - 1)), or None.
        joint_template: rest joints of the mean shape [m], shape (j, 3).
        joint_shapedirs: their displacement per shape coefficient [m], shape (j, 3, b).
        skin_weights: influence of each joint on each vertex, shape (n, j), rows sum to one.
        pose_mean: added to every pose (a relaxed hand) [rad], shape (j, 3).
        named_shapes: coefficients of the named shapes, shape (m, b).
        faces: triangles, shape (f, 3).
        parents: parent of each joint, -1 for the root; parents come before children.
        shape_names: names of the rows of `named_shapes`.
    """

    template: Float[Array, "n 3"]
    shapedirs: Float[Array, "n 3 b"]
    posedirs: Float[Array, "n 3 p"] | None
    joint_template: Float[Array, "j 3"]
    joint_shapedirs: Float[Array, "j 3 b"]
    skin_weights: Float[Array, "n j"]
    pose_mean: Float[Array, "j 3"]
    named_shapes: Float[Array, "m b"]
    faces: Int[Array, "f 3"]
    parents: tuple[int, ...] = static()
    shape_names: tuple[str, ...] = static()


@pytree
class BodyState:
    """A posed body.

    Args:
        vertices: positions [m], shape (n, 3).
        joints: posed joints [m], shape (j, 3).
    """

    vertices: Float[Array, "n 3"]
    joints: Float[Array, "j 3"]


@jax.jit
def forward(
    model: BodyModel,
    pose: Float[Array, "j 3"],
    shape: Float[Array, " b"],
    translation: Float[Array, "3"],
) -> BodyState:
    """Pose a body; differentiable in every argument, also at zero rotation.

    Args:
        model: the body.
        pose: rotation of each joint against its parent, axis times angle [rad], shape (j, 3);
            row 0 turns the whole body about its pelvis.
        shape: coefficients of the first shape components (standard deviations), shape (b,).
        translation: [m], shape (3,).

    Returns:
        Vertices and joints [m].

    Raises:
        ValueError: wrong shapes, or more coefficients than the model has components.
    """
    count = len(model.parents)
    if pose.shape != (count, 3) or translation.shape != (3,) or shape.ndim != 1:
        raise ValueError(
            f"pose, shape, translation must have shapes ({count}, 3), (b,), (3,), not "
            f"{pose.shape}, {shape.shape}, {translation.shape}"
        )
    used = shape.shape[0]
    if used > model.shapedirs.shape[2]:
        raise ValueError(
            f"{used} shape coefficients, but the body has {model.shapedirs.shape[2]} components"
        )
    rest = model.template + model.shapedirs[:, :, :used] @ shape
    joints = model.joint_template + model.joint_shapedirs[:, :, :used] @ shape
    rotations = rotation_matrices(pose + model.pose_mean)
    if model.posedirs is not None:
        correctives = (rotations[1:] - jnp.eye(3, dtype=rotations.dtype)[None]).reshape(-1)
        rest = rest + model.posedirs @ correctives
    turned, moved = _chain(model.parents, rotations, joints)

    # Offset of each joint's rigid motion: x -> R x + (t - R J).
    offsets = moved - jnp.einsum("jab,jb->ja", turned, joints)
    transforms = jnp.concatenate([turned.reshape(count, 9), offsets], axis=1)
    # One dense product: 55 columns are cheaper than gathering and scattering a few per vertex.
    blended = model.skin_weights @ transforms
    vertices = jnp.einsum("nab,nb->na", blended[:, :9].reshape(-1, 3, 3), rest) + blended[:, 9:]
    return BodyState(vertices=vertices + translation[None, :], joints=moved + translation[None, :])


def rotation_matrices(vectors: Float[Array, "j 3"]) -> Float[Array, "j 3 3"]:
    """Rotation matrices from axis times angle, smooth through zero.

        R = I + sin(t)/t K + (1 - cos t)/t^2 K^2,   K the cross-product matrix, t the angle

    Args:
        vectors: [rad], shape (j, 3).
    """
    squared = jnp.sum(vectors**2, axis=1)
    small = squared < SERIES_BELOW
    # The angle is replaced where the series is taken: its root has no derivative at zero.
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    first = jnp.where(small, 1.0 - squared / 6.0 * (1.0 - squared / 20.0), jnp.sin(angle) / angle)
    half = jnp.sin(0.5 * angle) / angle
    second = jnp.where(small, 0.5 - squared / 24.0 * (1.0 - squared / 30.0), 2.0 * half**2)
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    zero = jnp.zeros_like(x)
    cross = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    identity = jnp.eye(3, dtype=vectors.dtype)[None]
    return identity + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)


def named_shape(model: BodyModel, name: str) -> Float[Array, " b"]:
    """Shape coefficients of a named shape ("average" is all zeros).

    Raises:
        ValueError: the body has no shape of that name; the message lists those it has.
    """
    if name == "average":
        return jnp.zeros(model.shapedirs.shape[2], dtype=model.template.dtype)
    if name not in model.shape_names:
        known = ", ".join(("average", *model.shape_names))
        raise ValueError(f"there is no shape '{name}'; this body has {known}")
    return model.named_shapes[model.shape_names.index(name)]


def _chain(
    parents: tuple[int, ...], rotations: Float[Array, "j 3 3"], joints: Float[Array, "j 3"]
) -> tuple[Float[Array, "j 3 3"], Float[Array, "j 3"]]:
    """World rotations and positions of all joints, level by level of the tree."""
    levels = depth_levels(parents)
    turned, moved = rotations, joints  # right for the root already
    for level in levels[1:]:
        children = jnp.array(level)
        above = jnp.array([parents[joint] for joint in level])
        bones = joints[children] - joints[above]
        positions = moved[above] + jnp.einsum("jab,jb->ja", turned[above], bones)
        turned = turned.at[children].set(turned[above] @ rotations[children])
        moved = moved.at[children].set(positions)
    return turned, moved

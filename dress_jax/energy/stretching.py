"""The membrane of a cloth: the energy and the Hessian of the model that it chose."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.components import Components
from dress_jax.energy.cloth import Cloth, Parameters
from dress_jax.energy.deformation import add_isotropic, principal_frame
from dress_jax.energy.gathers import find_gathers, gathered_triangles
from dress_jax.energy.membrane import (
    MembraneFrame,
    MembraneModel,
    isotropic_hessian,
    membrane_energy,
    principal_stretches,
)
from dress_jax.energy.orthotropic import (
    OrthotropicStiffness,
    orthotropic_energy,
    orthotropic_hessian,
)
from dress_jax.energy.rest import RestTriangles
from dress_jax.energy.strain_limit import strain_limit_energy, strain_limit_hessian


def orthotropic_stiffness(parameters: Parameters) -> OrthotropicStiffness:
    """The leaves of the parameters that the orthotropic membrane takes."""
    return OrthotropicStiffness(
        warp=parameters.warp_stiffness,
        weft=parameters.weft_stiffness,
        shear=parameters.shear_stiffness,
        poisson_ratio=parameters.poisson_ratio,
        grain_angle=parameters.grain_angle,
    )


def stretching_rest(parameters: Parameters, cloth: Cloth) -> RestTriangles:
    """The rest shape of the membrane."""
    return gathered_triangles(parameters.rest_positions, cloth.rest_faces, cloth.gathers)


def stretching_energy(
    positions: Components,
    faces: Array,
    rest: RestTriangles,
    parameters: Parameters,
    model: MembraneModel,
) -> Float[Array, ""]:
    """The energy of the membrane and of its strain limit, where it has one [J].

    Args:
        positions: components (3 of (n,)) of the vertices [m].
        faces: vertices of each triangle, (3, f).
        rest: of the same triangles.
    """
    if model is MembraneModel.ORTHOTROPIC:
        energy = orthotropic_energy(positions, faces, rest, orthotropic_stiffness(parameters))
    else:
        energy = membrane_energy(
            positions,
            faces,
            rest,
            parameters.stretching_stiffness,
            parameters.poisson_ratio,
            model,
        )
    if parameters.strain_limit is None:
        return energy
    return energy + strain_limit_energy(positions, faces, rest, parameters.strain_limit)


def stretching_frame(
    positions: Components, parameters: Parameters, cloth: Cloth, *, project: bool = True
) -> MembraneFrame:
    """Hessians of the membrane in the triangles' principal frames.

    Args:
        positions: components (3 of (n,)) of the vertices [m].
        project: to positive semidefinite; otherwise they are exact.
    """
    rest = stretching_rest(parameters, cloth)
    frame = principal_frame(positions, cloth.faces, rest)
    if cloth.membrane is MembraneModel.ORTHOTROPIC:
        hessian = orthotropic_hessian(
            frame, rest.areas, orthotropic_stiffness(parameters), project=project
        )
    else:
        hessian = isotropic_hessian(
            frame,
            rest.areas,
            parameters.stretching_stiffness,
            parameters.poisson_ratio,
            cloth.membrane,
            project=project,
        )
    if parameters.strain_limit is not None:
        limit = strain_limit_hessian(frame, rest.areas, parameters.strain_limit)
        hessian = add_isotropic(hessian, limit)
    return MembraneFrame(frame.axes, frame.alpha, frame.beta, hessian)


def mesh_stretches(
    positions: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    rest_positions: Float[np.ndarray, "p 2"],
    rest_faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, "2 f"]:
    """The principal stretches of every triangle, the larger one first, on the host.

    Of gathers only what their folds do not take up (`energy.gathers`).

    Args:
        positions: welded vertices [m].
        faces: triangles in welded vertices.
        rest_positions: panel coordinates [m].
        rest_faces: the same triangles in panel vertices.
    """
    rest = gathered_triangles(
        jnp.asarray(rest_positions),
        jnp.asarray(rest_faces.T),
        find_gathers(faces, rest_faces, rest_positions),
    )
    stretches = principal_stretches(jnp.asarray(positions), jnp.asarray(faces.T), rest)
    return np.stack([np.asarray(stretch) for stretch in stretches])

"""Which numbers of the fabric a fit may change: two for the garment, or more (beyond S9.1).

Every such number is one entry of `Unknowns.log_stiffness`: the logarithm of a factor on a
stiffness of the initial fabric, so that stiffnesses stay positive (S9.14); of the anisotropy of
bending, which has bounds, the shift of its area hyperbolic tangent.
"""

import dataclasses
import enum
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree, replace, static
from dress_jax.energy.cloth import STRETCHING_LEAVES, Cloth, Parameters
from dress_jax.energy.material import LARGEST_ANISOTROPY
from dress_jax.energy.membrane import MembraneModel
from dress_jax.pattern import Pattern
from dress_jax.pattern.mirror import find_mirror


class FabricUnknown(enum.Enum):
    """One number of a fabric."""

    STRETCHING = "stretching"
    BENDING = "bending"
    WARP = "warp"
    WEFT = "weft"
    SHEAR = "shear"
    BENDING_ANISOTROPY = "bending anisotropy"

    @property
    def is_factor(self) -> bool:
        """Whether it multiplies a stiffness."""
        return self is not FabricUnknown.BENDING_ANISOTROPY

    @property
    def bends(self) -> bool:
        """Whether it is about bending, and not about stretching."""
        return self in (FabricUnknown.BENDING, FabricUnknown.BENDING_ANISOTROPY)


_ISOTROPIC = (FabricUnknown.STRETCHING, FabricUnknown.BENDING)
_ANISOTROPIC = (
    FabricUnknown.WARP,
    FabricUnknown.WEFT,
    FabricUnknown.SHEAR,
    FabricUnknown.BENDING,
    FabricUnknown.BENDING_ANISOTROPY,
)
_OF_LEAF = dict(
    zip(
        STRETCHING_LEAVES,
        (FabricUnknown.STRETCHING, FabricUnknown.WARP, FabricUnknown.WEFT, FabricUnknown.SHEAR),
        strict=True,
    )
)


@dataclasses.dataclass(frozen=True)
class FabricFreedom:
    """How many fabrics a garment may be of, and what of them is unknown.

    Attributes:
        per_panel: every panel has its own; panels that mirror each other share one.
        warp_weft: stiffness along warp and weft, in shear, and the anisotropy of bending, instead
            of one stretching stiffness; needs the orthotropic membrane.
    """

    per_panel: bool = False
    warp_weft: bool = False


@pytree
class FabricTable:
    """From unknowns to leaves of `Parameters`: which unknown scales which entry.

    Attributes:
        stretching: for each of `STRETCHING_LEAVES`, () or per triangle (f,).
        bending: of the two sides of each hinge, (2, h), or ().
        anisotropy: as `stretching`, or None where it is not fitted.
        names: of the unknowns, in order.
        kinds: what each is.
        groups: which fabric each belongs to.
    """

    stretching: tuple[Int[np.ndarray, "*f"], ...]
    bending: Int[np.ndarray, "*h"]
    anisotropy: Int[np.ndarray, "*f"] | None
    names: tuple[str, ...] = static()
    kinds: tuple[FabricUnknown, ...] = static()
    groups: tuple[int, ...] = static()


def make_fabric_table(
    freedom: FabricFreedom,
    pattern: Pattern,
    cloth: Cloth,
    face_panel: Int[np.ndarray, " f"],
) -> FabricTable:
    """Number the unknowns of a garment's fabrics.

    Args:
        freedom: which there are.
        pattern: tells which panels mirror each other.
        cloth: topology of the garment.
        face_panel: panel of each triangle.

    Raises:
        InputError: warp and weft are asked of an isotropic membrane.
    """
    if freedom.warp_weft and cloth.membrane is not MembraneModel.ORTHOTROPIC:
        raise InputError(
            f"the {cloth.membrane.value} membrane has no warp and weft",
            where="fabric unknowns",
            mend="use the orthotropic membrane",
        )
    kinds = _ANISOTROPIC if freedom.warp_weft else _ISOTROPIC
    group = _groups(pattern) if freedom.per_panel else np.zeros(len(pattern.panels), int)
    count = int(group.max()) + 1
    names = [
        f"{kind.value} of {_members(pattern, group == k)}" if freedom.per_panel else kind.value
        for k in range(count)
        for kind in kinds
    ]

    def number(kind: FabricUnknown, of: np.ndarray) -> Int[np.ndarray, "*f"]:
        # What this membrane does not use may follow anything.
        place = kinds.index(kind) if kind in kinds else 0
        return (np.asarray(of) * len(kinds) + place).astype(np.int32)

    owner, hinge_owner = np.zeros((), int), np.zeros((), int)
    if freedom.per_panel:
        owner = group[np.asarray(face_panel)]
        hinge_owner = owner[np.asarray(cloth.hinge_faces)]
    return FabricTable(
        stretching=tuple(number(_OF_LEAF[leaf], owner) for leaf in STRETCHING_LEAVES),
        bending=number(FabricUnknown.BENDING, hinge_owner),
        anisotropy=number(FabricUnknown.BENDING_ANISOTROPY, owner) if freedom.warp_weft else None,
        names=tuple(names),
        kinds=kinds * count,
        groups=tuple(np.repeat(np.arange(count), len(kinds)).tolist()),
    )


def with_fabric(
    parameters: Parameters, log_stiffness: Float[Array, " s"], table: FabricTable
) -> Parameters:
    """Parameters of the initial fabrics with their unknowns' values, differentiable.

    A hinge on a seam takes the mean of the factors on its two sides.

    Args:
        parameters: of the initial fabrics.
        log_stiffness: values of the unknowns.
        table: which is which.
    """
    factor = jnp.exp(log_stiffness)
    leaves = {
        name: getattr(parameters, name) * factor[index]
        for name, index in zip(STRETCHING_LEAVES, table.stretching, strict=True)
    }
    bending = factor[table.bending]
    bending = jnp.mean(bending, axis=0) if bending.ndim else bending
    leaves["bending_stiffness"] = parameters.bending_stiffness * bending
    if table.anisotropy is not None:
        begin = jnp.arctanh(parameters.bending_anisotropy / LARGEST_ANISOTROPY)
        shift = log_stiffness[table.anisotropy]
        leaves["bending_anisotropy"] = LARGEST_ANISOTROPY * jnp.tanh(begin + shift)
    return replace(parameters, **leaves)


def initial_values(
    table: FabricTable, initial_stiffness: tuple[float, float]
) -> Float[np.ndarray, " s"]:
    """Values of the unknowns to begin with.

    Args:
        table: which there are.
        initial_stiffness: factors on stretching and bending.
    """
    stretching, bending = np.log(initial_stiffness)
    return np.array(
        [(bending if kind.bends else stretching) if kind.is_factor else 0.0 for kind in table.kinds]
    )


def named_values(table: FabricTable, log_stiffness: Float[np.ndarray, " s"]) -> dict[str, float]:
    """The unknowns by name: factors, and the shift of the anisotropy (host)."""
    values = np.asarray(log_stiffness, np.float64)
    return {
        name: float(np.exp(value)) if kind.is_factor else float(value)
        for name, kind, value in zip(table.names, table.kinds, values, strict=True)
    }


def likely_alike(
    table: FabricTable, scale: float, difference_scale: float
) -> Float[np.ndarray, "s s"]:
    """What the prior says about the unknowns, as a quadratic's matrix.

    The mean over a garment's fabrics counts in the scale, and how each differs from the mean in the
    other one: a garment is mostly of one cloth.

    Args:
        table: which there are.
        scale: of the mean.
        difference_scale: of the differences.
    """
    kinds = len(table.kinds) // (max(table.groups) + 1)
    count = len(table.kinds) // kinds
    mean = np.full((count, count), 1.0 / count)
    own = mean / (count * scale**2) + (np.eye(count) - mean) / difference_scale**2
    return np.kron(own, np.eye(kinds))


def _groups(pattern: Pattern) -> Int[np.ndarray, " panels"]:
    """Numbers of the panels' fabrics, in the panels' order."""
    group = np.arange(len(pattern.panels))
    for pair in find_mirror(pattern).pairs:
        group[group == group[pair.second]] = group[pair.first]
    return np.unique(group, return_inverse=True)[1]


def _members(pattern: Pattern, chosen: Sequence[bool] | np.ndarray) -> str:
    return ", ".join(p.name for p, own in zip(pattern.panels, chosen, strict=True) if own)

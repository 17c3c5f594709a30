"""HTML with everything inside: style, pictures as data, scripts."""

import base64
import dataclasses
import importlib.resources
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import write_text

_QUALITY = 88  # of JPEG
_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".jpg": "image/jpeg"}


@dataclasses.dataclass(frozen=True)
class Page:
    """A page.

    Attributes:
        title: plain text.
        head: HTML that stands before the sections.
        sections: heading (plain text) and HTML of each; those without HTML are left out.
    """

    title: str
    head: str
    sections: Sequence[tuple[str, str]]


def write_document(path: str | Path, page: Page) -> None:
    """Write a page as one file, atomically.

    Raises:
        InputError: the place cannot be written to.
    """
    body = [f"<h1>{text(page.title)}</h1>", page.head]
    body += [
        f"<section><h2>{text(heading)}</h2>\n{html}</section>"
        for heading, html in page.sections
        if html
    ]
    document = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{text(page.title)}</title>
<style>
{_asset("page.css")}</style>
</head>
<body>
{chr(10).join(body)}
<script>
{_asset("viewer.js")}</script>
</body>
</html>
"""
    write_text(path, document)


def text(value: object) -> str:
    """Plain text, safe inside HTML."""
    return escape(str(value), quote=True)


def picture(pixels: UInt8[np.ndarray, "h w 3"], caption: str = "", *, longest: int = 640) -> str:
    """A figure of 8-bit pixels, made smaller where its longer side is beyond `longest` [px]."""
    image = Image.fromarray(np.asarray(pixels, np.uint8)).convert("RGB")
    image.thumbnail((longest, longest))
    buffer = io.BytesIO()
    image.save(buffer, format="JPEG", quality=_QUALITY)
    return _figure(buffer.getvalue(), "image/jpeg", caption, image.size)


def picture_of_file(path: str | Path, caption: str = "") -> str:
    """A figure of a PNG, JPEG or SVG file.

    Raises:
        InputError: there is no such file, or it is of another kind.
    """
    path = Path(path)
    kind = _TYPES.get(path.suffix.lower())
    if kind is None or not path.is_file():
        raise InputError("is no picture for a page", where=str(path), mend="make it again")
    return _figure(path.read_bytes(), kind, caption, None)


def _figure(content: bytes, kind: str, caption: str, size: tuple[int, int] | None) -> str:
    data = base64.b64encode(content).decode("ascii")
    sides = "" if size is None else f' width="{size[0]}" height="{size[1]}"'
    below = f"<figcaption>{text(caption)}</figcaption>" if caption else ""
    source = f"data:{kind};base64,{data}"
    return f'<figure><img src="{source}" alt="{text(caption)}"{sides}>{below}</figure>'


def _asset(name: str) -> str:
    resource = importlib.resources.files("dress_jax.io.page") / name
    return resource.read_text(encoding="utf-8")

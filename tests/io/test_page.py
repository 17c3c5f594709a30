"""The page is one file that asks no other host, and its meshes come back from their text."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.io.page import Page, ViewedMesh, picture, picture_of_file, viewer, write_document

VOID = {"meta", "img", "br", "link", "input"}
STEP = 1.0 / 65535  # of the largest extent


class Reader(HTMLParser):
    """Elements that are opened and closed in order, and what they load."""

    def __init__(self):
        super().__init__()
        self.open, self.loads, self.texts, self.tags = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.loads += [value for key, value in attrs if key in ("src", "href", "data", "srcset")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def mesh(**changes):
    rng = np.random.default_rng(3)
    values = {
        "name": "cloth </script> & <b>",
        "vertices": rng.normal(size=(70000, 3)),  # more than 16-bit indices count
        "faces": np.array([[0, 1, 69999], [2, 69998, 3]]),
        "color": (0.1, 0.2, 0.3),
    }
    return ViewedMesh(**(values | changes))


def test_meshes_come_back(tmp_path):
    one = mesh()
    html = viewer("scene", [one], instead="<p>still</p>")
    data = re.search(r'<script type="application/json" id="scene">(.*?)</script>', html, re.S)
    assert data is not None
    [packed] = json.loads(data.group(1).replace("<\\/", "</"))["meshes"]
    assert packed["name"] == one.name and packed["shown"]
    steps = np.frombuffer(base64.b64decode(packed["positions"]), "<u2").reshape(-1, 3)
    vertices = np.asarray(packed["origin"]) + packed["step"] * steps
    assert np.abs(vertices - one.vertices).max() <= STEP * np.ptp(one.vertices, axis=0).max()
    faces = np.frombuffer(base64.b64decode(packed["indices"]), "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(faces, one.faces)
    for wrong in ({"faces": np.zeros((0, 3), int)}, {"vertices": np.full((70000, 3), np.nan)}):
        with pytest.raises(InputError, match="has no triangles, or is not finite"):
            viewer("scene", [mesh(**wrong)], instead="")


def test_a_page_holds_everything_itself(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (50, 900, 3), dtype=np.uint8)
    (tmp_path / "a.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    page = Page(
        title="<Dress> & co",
        head=picture(pixels, "a <wide> picture", longest=300),
        sections=[
            ("first", picture_of_file(tmp_path / "a.svg", "drawing")),
            ("none", ""),
            ("view", viewer("scene", [mesh()], instead="<p>still</p>")),
        ],
    )
    write_document(tmp_path / "page.html", page)
    html = (tmp_path / "page.html").read_text(encoding="utf-8")
    reader = Reader()
    reader.feed(html)
    assert reader.open == []
    assert all(load.startswith("data:") for load in reader.loads) and len(reader.loads) == 2
    assert not re.search(r"url\(|@import|fetch\(|XMLHttpRequest|https?://(?!www\.w3\.org)", html)
    assert 'width="300" height="17"' in html
    assert "&lt;Dress&gt; &amp; co" in html and "<Dress>" not in html
    assert reader.tags.count("h2") == 2  # a section without content is left out
    assert 'name="viewport"' in html and "<p>still</p>" in html
    # Three scripts at most end the document: data, and the view's own program.
    assert html.count("</script>") == 2


def test_pictures_that_are_none_are_refused(tmp_path):
    for name in ("none.png", "text.txt"):
        with pytest.raises(InputError, match=name):
            picture_of_file(tmp_path / name)

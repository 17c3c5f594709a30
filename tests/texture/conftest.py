"""Pictures of a checked tube from eight sides, shared by the tests of the texture."""

import numpy as np
import pytest
import texture_scenes as scenes

from dress_jax.texture.atlas import pack_panels
from dress_jax.texture.baking import View
from dress_jax.texture.panel_maps import panel_map
from dress_jax.texture.textured import atlas_texture, draw_textured


@pytest.fixture(scope="session")
def tube():
    return scenes.tube()


@pytest.fixture(scope="session")
def atlas(tube):
    return pack_panels(tube, scenes.TEXEL)


@pytest.fixture(scope="session")
def cloth(atlas):
    """The true picture of the atlas: checks."""
    return scenes.checks((atlas.height, atlas.width), scenes.TEXEL, scenes.PERIOD)


@pytest.fixture(scope="session")
def views(tube, atlas, cloth):
    texture = atlas_texture(cloth, atlas, tube)
    made = []
    for camera in scenes.cameras():
        picture, mask = draw_textured(
            camera, tube, texture, scenes.body(), supersampling=4, lit=False
        )
        made.append(View(camera, picture, mask, panel_map(camera, tube, scenes.body())))
    return made


@pytest.fixture(scope="session")
def front_cut(views):
    """The largest even square of the front view, as flat cloth."""
    from dress_jax.texture.cut import cut_cloth
    from dress_jax.texture.square import even_cloth, uniform_square

    front = views[0]
    allowed = even_cloth(front.seen, front.mask >= 0.99, front.seen.cosine, smallest_cosine=0.5)
    square = uniform_square(front.picture, allowed)
    assert square is not None
    cut = cut_cloth(front.picture, front.seen, square)
    assert cut is not None
    assert np.isfinite(cut.image).all()
    return square, cut

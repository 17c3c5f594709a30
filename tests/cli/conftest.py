"""One drape through the command line, shared by the tests that look at its folder."""

import pytest
from command_scenes import small_skirt, turned_body
from typer.testing import CliRunner

from dress_jax.cli.main import app
from dress_jax.io.meshes import write_body_obj
from dress_jax.io.patterns import save_pattern

EDGE_LENGTH = 0.06


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    """A folder with `skirt.json` and `body.obj`."""
    folder = tmp_path_factory.mktemp("inputs")
    save_pattern(small_skirt(), folder / "skirt.json")
    write_body_obj(folder / "body.obj", *turned_body())
    return folder


@pytest.fixture(scope="session")
def run():
    """Runs the program in this process."""

    def invoke(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return invoke


@pytest.fixture(scope="session")
def draped(inputs, run, tmp_path_factory):
    """The folder of a draped skirt, and what the command printed."""
    folder = tmp_path_factory.mktemp("draped") / "skirt"
    result = run(
        "drape",
        inputs / "skirt.json",
        "--body",
        inputs / "body.obj",
        "--edge-length",
        EDGE_LENGTH,
        "--out",
        folder,
    )
    assert result.exit_code == 0, result.output
    return folder, result

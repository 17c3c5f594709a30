"""Tiles from elsewhere: a picture file, or the output of a texture generator (S14.1, S14.3)."""

import shlex
import subprocess
import tempfile
from pathlib import Path

from dress_jax.core.errors import InputError
from dress_jax.io.images import read_rgb, write_rgb
from dress_jax.texture.cut import Cut
from dress_jax.texture.tiling import Tile

_SAID = 300  # characters of a failing program's last words


def read_tile(path: str | Path, width: float) -> Tile:
    """A tileable picture of known size.

    Args:
        path: the picture; taken as it is, so it should continue itself.
        width: of the cloth that it shows [m]; the height follows from the picture's shape.

    Raises:
        InputError: the picture cannot be read, or the width is not positive.
    """
    if not width > 0.0:
        raise InputError(f"the tile's width is {width} m", where=str(path), mend="give centimetres")
    image = read_rgb(path)
    return Tile(image=image.astype(float), size=(width, width * image.shape[0] / image.shape[1]))


def run_tile_command(template: str, cut: Cut, width: float | None = None) -> Tile:
    """Let a program of the user's make a tile of a piece of cloth.

    Args:
        template: the command line, such as `tool --in {crop} --out {tile}`; it is split as a shell
            would, but no shell runs it.
        cut: the piece, which the program finds as a PNG at `{crop}`.
        width: of the cloth that the tile shows [m]; that of the cut when None.

    Returns:
        The picture that the program left at `{tile}`.

    Raises:
        InputError: a placeholder is missing, the program cannot be run, fails, or leaves no
            picture.
    """
    where = "tile command"
    for name in ("{crop}", "{tile}"):
        if name not in template:
            raise InputError(
                f"'{template}' lacks {name}",
                where=where,
                mend="write it as in 'tool --in {crop} --out {tile}'",
            )
    try:
        words = shlex.split(template)
    except ValueError as error:
        raise InputError(
            f"'{template}' cannot be split into words ({error})",
            where=where,
            mend="close the quotation marks",
        ) from error
    with tempfile.TemporaryDirectory(prefix="dress_jax_tile_") as folder:
        crop, tile = Path(folder) / "crop.png", Path(folder) / "tile.png"
        write_rgb(crop, cut.image)
        command = [w.replace("{crop}", str(crop)).replace("{tile}", str(tile)) for w in words]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", check=False
            )
        except OSError as error:
            raise InputError(
                f"'{words[0]}' cannot be run ({error.strerror})",
                where=where,
                mend="check the program's name and that it is executable",
            ) from error
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
            raise InputError(
                f"'{words[0]}' ended with exit code {done.returncode}: {said[-_SAID:]}",
                where=where,
                mend="run it by hand on a picture to see what it lacks",
            )
        if not tile.is_file():
            raise InputError(
                f"'{words[0]}' wrote no file at {{tile}}",
                where=where,
                mend="see that the option before {tile} names the output",
            )
        return read_tile(tile, cut.side if width is None else width)

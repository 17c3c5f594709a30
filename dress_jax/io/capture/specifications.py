"""Initial patterns of SewFormer, NeuralTailor, AIpparel and GarmentCode (S3.1).

All four write `specification.json` in dialects that `pattern.specification` tells apart; which tool
it was is known from the user only.
"""

from pathlib import Path

from dress_jax.capture.bundle import Bundle
from dress_jax.core.errors import InputError
from dress_jax.io.patterns import load_pattern


def read_specification(path: str | Path, *, tool: str = "specification") -> Bundle:
    """The pattern where a fit may begin.

    Args:
        path: the specification, or a folder that holds exactly one `*specification.json`.
        tool: its name for the bundle's record.

    Raises:
        InputError: the file is no valid pattern, or the folder holds none or several.
    """
    path = Path(path)
    if path.is_dir():
        found = sorted(path.glob("*specification.json"))
        if len(found) != 1:
            raise InputError(
                f"holds {len(found)} files *specification.json",
                where=str(path),
                mend="name the one to read",
            )
        path = found[0]
    return Bundle(pattern=load_pattern(path), sources={"pattern": tool})

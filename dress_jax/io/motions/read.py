"""Any file of a motion, by its ending."""

from collections.abc import Callable
from pathlib import Path

from dress_jax.core.errors import InputError
from dress_jax.io.motions.bvh_skeleton import read_bvh
from dress_jax.io.motions.smpl_files import read_aist, read_amass
from dress_jax.motion.retarget import SourceMotion

FORMATS = {".npz": "AMASS", ".pkl": "AIST++", ".bvh": "BVH"}


def read_motion(path: str | Path, *, same_rest: bool = False) -> SourceMotion:
    """A motion from an AMASS `.npz`, AIST++ `.pkl` or `.bvh` file.

    Args:
        path: the file.
        same_rest: the body that will move is of the SMPL family itself.

    Raises:
        InputError: another ending, or the file cannot be used.
    """
    path = Path(path)
    readers: dict[str, Callable[[], SourceMotion]] = {
        ".npz": lambda: read_amass(path, same_rest=same_rest),
        ".pkl": lambda: read_aist(path, same_rest=same_rest),
        ".bvh": lambda: read_bvh(path),
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(f"{ending} ({name})" for ending, name in FORMATS.items())
        raise InputError(
            f"'{path}' is neither a motion of ours nor a file that is known",
            where="motion",
            mend=f"give walk, turn, sway, or a file ending in {known}",
        )
    return reader()

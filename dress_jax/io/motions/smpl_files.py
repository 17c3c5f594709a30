"""Motions of SMPL bodies: AMASS archives and AIST++ pickles (S15).

AMASS: `poses` (T, 165) of SMPL-X or (T, 156) of SMPL-H, rotation vectors [rad]; `trans` (T, 3) [m];
the world has +z up. SMPL-X: 22 joints of the body, jaw, two eyes, 15 joints a hand. SMPL-H: the
body and the hands. The rate is `mocap_frame_rate` or `mocap_framerate`.

AIST++: `smpl_poses` (N, 72) of SMPL, `smpl_trans` (N, 3), `smpl_scaling` (1,): metres are the
translation over the scaling; 60 frames per second, +y up. SMPL's two hand joints are left out.
"""

from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.capture.pickles import read_pickle
from dress_jax.motion.retarget import SourceMotion, smpl_motion

_RATES = ("mocap_frame_rate", "mocap_framerate")
_AIST_FPS = 60.0
_BODY, _HANDS = 22, 25  # joints before the face, and before the hands of SMPL-X


def read_amass(path: str | Path, *, same_rest: bool = False) -> SourceMotion:
    """A motion of AMASS.

    Args:
        path: the `.npz` file.
        same_rest: the body that will move is of the SMPL family itself.

    Raises:
        InputError: the file is missing, or lacks poses, translation or rate, or they do not fit.
    """
    path = Path(path)
    arrays = read_npz(path)
    if "poses" not in arrays:
        raise InputError(
            f"has no 'poses' (it holds {', '.join(sorted(arrays)) or 'no plain arrays'})",
            where=str(path),
            mend="give a motion of AMASS; files named shape.npz and neutral_stagei.npz hold none",
        )
    poses = _numbers(path, arrays, "poses", 2)
    root = _numbers(path, arrays, "trans", 2)
    frames, width = poses.shape
    pose = np.zeros((frames, 55, 3))
    if width == 165:
        pose[:] = poses.reshape(frames, 55, 3)
    elif width == 156:
        joints = poses.reshape(frames, 52, 3)
        pose[:, :_BODY], pose[:, _HANDS:] = joints[:, :_BODY], joints[:, _BODY:]
    else:
        raise InputError(
            f"'poses' has shape {poses.shape}",
            where=str(path),
            mend="give SMPL-X (T, 165) or SMPL-H (T, 156)",
        )
    _check_frames(path, root, frames)
    rate = next((key for key in _RATES if key in arrays), None)
    if rate is None:
        raise InputError(
            "has no frame rate", where=str(path), mend=f"add {' or '.join(_RATES)} to the file"
        )
    fps = float(_numbers(path, arrays, rate, 0))
    return smpl_motion(pose, root, fps=fps, z_up=True, name=path.name, same_rest=same_rest)


def read_aist(path: str | Path, *, same_rest: bool = False) -> SourceMotion:
    """A dance of AIST++; nothing but numpy arrays and plain values is unpickled.

    Args:
        path: the `.pkl` file.
        same_rest: the body that will move is of the SMPL family itself.

    Raises:
        InputError: the file is missing, asks for more than data, or lacks a part.
    """
    path = Path(path)
    values = read_pickle(path)
    poses = _numbers(path, values, "smpl_poses", 2)
    root = _numbers(path, values, "smpl_trans", 2)
    scaling = _numbers(path, values, "smpl_scaling", None)
    if scaling.size != 1 or not float(scaling.ravel()[0]) > 0.0:
        raise InputError(
            f"'smpl_scaling' has shape {scaling.shape} or is not positive",
            where=str(path),
            mend="give one positive number",
        )
    if poses.shape[1] != 72:
        raise InputError(
            f"'smpl_poses' has shape {poses.shape}", where=str(path), mend="give SMPL (N, 72)"
        )
    _check_frames(path, root, len(poses))
    pose = np.zeros((len(poses), 55, 3))
    pose[:, :_BODY] = poses.reshape(len(poses), 24, 3)[:, :_BODY]
    root = root / float(scaling.ravel()[0])
    return smpl_motion(pose, root, fps=_AIST_FPS, z_up=False, name=path.name, same_rest=same_rest)


def _numbers(path: Path, arrays: dict[str, Any], key: str, dimensions: int | None) -> np.ndarray:
    if key not in arrays:
        raise InputError(
            f"has no '{key}'", where=str(path), mend="give the file as its authors distribute it"
        )
    try:
        array = np.asarray(arrays[key], np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"'{key}' holds no numbers", where=str(path)) from error
    if dimensions is not None and array.ndim != dimensions:
        raise InputError(
            f"'{key}' has shape {array.shape}",
            where=str(path),
            mend=f"give an array of {dimensions} dimensions" if dimensions else "give one number",
        )
    if not np.isfinite(array).all():
        raise InputError(
            f"'{key}' holds numbers that are not finite",
            where=str(path),
            mend="cut such frames out",
        )
    return array


def _check_frames(path: Path, root: np.ndarray, frames: int) -> None:
    if root.shape != (frames, 3) or not frames:
        raise InputError(
            f"{frames} poses and translations of shape {root.shape}",
            where=str(path),
            mend="give as many of both, at least one",
        )

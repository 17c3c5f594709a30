"""Pickles of numpy data, read without running what else they may ask for.

A pickle is a program: reading one with the standard module runs whatever it names. The reader here
admits numpy arrays, numpy scalars and types, and Python's own numbers, texts and containers, and
refuses every other name, so that a data set's file can do nothing but hold data.
"""

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.core.errors import InputError

_BUILTINS = {"list", "dict", "tuple", "set", "frozenset", "int", "float", "bool", "str", "bytes"}
_BUILTINS |= {"bytearray", "complex", "slice"}
# What arrays and scalars ask for when they are read back; numpy moved the modules about.
_NUMPY = {
    "ndarray": np.ndarray,
    "dtype": np.dtype,
    "_reconstruct": np.zeros(1).__reduce__()[0],
    "_frombuffer": np.zeros(1).__reduce_ex__(5)[0],
    "scalar": np.float64(0.0).__reduce__()[0],
}
_NUMPY_MODULES = {"numpy", "multiarray", "numeric"}


class _NumpyOnly(pickle.Unpickler):
    """Finds the names that arrays need, and no others."""

    def find_class(self, module: str, name: str) -> Any:
        package, _, last = module.partition(".")
        if package == "numpy" and (last or "numpy").split(".")[-1] in _NUMPY_MODULES:
            if name in _NUMPY:
                return _NUMPY[name]
        elif module in ("builtins", "__builtin__") and name in _BUILTINS:
            return super().find_class("builtins", name)
        elif (module, name) == ("_codecs", "encode"):
            return super().find_class(module, name)  # how older pickles write bytes
        raise pickle.UnpicklingError(f"{module}.{name}")


def read_pickle(path: str | Path) -> dict[str, Any]:
    """A pickled dictionary of numpy data.

    Raises:
        InputError: the file is missing, no pickle, names something else than numpy arrays and
            plain values, or holds no dictionary.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), mend="check the path"
        ) from error
    try:
        value = _NumpyOnly(io.BytesIO(content), encoding="latin1").load()
    except pickle.UnpicklingError as error:
        if "." in str(error) and " " not in str(error):
            raise InputError(
                f"asks for {error}, which is neither a numpy array nor a plain value",
                where=str(path),
                mend="do not read this file with the pickle module; save its arrays as npz",
            ) from error
        raise InputError("is no pickle", where=str(path), mend="copy the file again") from error
    except Exception as error:  # a damaged pickle raises whatever its program runs into
        raise InputError(
            f"cannot be read ({type(error).__name__})", where=str(path), mend="copy the file again"
        ) from error
    if not isinstance(value, dict):
        raise InputError(f"holds a {type(value).__name__}, not a dictionary", where=str(path))
    return {str(key): item for key, item in value.items()}

"""JSON documents: read with errors that name the line, written with finite numbers only."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import write_text


def read_json(path: str | Path, *, what: str) -> dict[str, Any]:
    """A JSON file that holds an object.

    Args:
        path: the file.
        what: what the file should be, for messages ("a sewing pattern").

    Raises:
        InputError: the file is missing, unreadable, no JSON (names line and column), or its top
            level is no object.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), mend="check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            "is not a UTF-8 text file", where=str(path), mend=f"give {what} in JSON"
        ) from error
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"is no valid JSON ({error.msg})",
            where=f"{path}, line {error.lineno}, column {error.colno}",
            mend="correct the file there, or write it again",
        ) from error
    if not isinstance(document, dict):
        raise InputError(
            f"holds a {type(document).__name__} instead of an object",
            where=str(path),
            mend=f"give {what} in JSON, which starts with '{{'",
        )
    return document


def write_json(path: str | Path, document: Mapping[str, Any], *, sort_keys: bool = False) -> None:
    """Write a JSON file atomically; numpy and JAX arrays become lists.

    Raises:
        ValueError: a number is not finite (JSON has none) or a type has no JSON form; the message
            names the key.
    """
    text = json.dumps(to_plain(document), indent=2, sort_keys=sort_keys, allow_nan=False)
    write_text(path, text + "\n")


def to_plain(value: Any, *, nonfinite_to_null: bool = False, where: str = "") -> Any:
    """Plain Python values out of numpy scalars, arrays, paths and enumerations.

    Args:
        value: anything made of mappings, sequences, arrays, numbers, texts, None.
        nonfinite_to_null: write NaN and infinities as null instead of refusing them.
        where: key path so far, for messages.

    Raises:
        ValueError: a number is not finite, or a type has no JSON form.
    """
    if isinstance(value, Mapping):
        return {
            str(key): to_plain(item, nonfinite_to_null=nonfinite_to_null, where=f"{where}/{key}")
            for key, item in value.items()
        }
    if isinstance(value, (list, tuple)):
        return [
            to_plain(item, nonfinite_to_null=nonfinite_to_null, where=f"{where}/{k}")
            for k, item in enumerate(value)
        ]
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, int):
        return int(value)  # also enumerations of integers
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        if nonfinite_to_null:
            return None
        raise ValueError(f"{where or 'the value'} is {value}, which JSON cannot hold")
    if hasattr(value, "__array__"):
        plain = np.asarray(value).tolist()
        return to_plain(plain, nonfinite_to_null=nonfinite_to_null, where=where)
    raise ValueError(f"{where or 'the value'} is a {type(value).__name__}, which JSON cannot hold")

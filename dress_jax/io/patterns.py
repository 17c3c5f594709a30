"""Sewing patterns from and to `specification.json` files (checklist S3.1)."""

from pathlib import Path

from dress_jax.io.documents import read_json, write_json
from dress_jax.pattern.model import Pattern
from dress_jax.pattern.rules import Rule, parse_rules
from dress_jax.pattern.specification import parse_specification
from dress_jax.pattern.specification_writer import to_specification


def load_pattern(path: str | Path, *, euler: str = "zyx") -> Pattern:
    """Read a pattern.

    Args:
        path: the specification file.
        euler: how its rotation angles compose, "zyx" or "xyz".

    Raises:
        InputError: the file cannot be read, is no JSON, or is no valid pattern.
    """
    document = read_json(path, what="a sewing pattern")
    return parse_specification(document, source=str(path), euler=euler)


def load_rules(path: str | Path, pattern: Pattern) -> tuple[Rule, ...]:
    """Read design rules of a pattern; `pattern.rules.parse_rules` says how they are written.

    Raises:
        InputError: the file cannot be read, or holds something that is no rule of the pattern.
    """
    document = read_json(path, what="design rules")
    return parse_rules(document, pattern, where=str(path))


def save_pattern(pattern: Pattern, path: str | Path) -> None:
    """Write a pattern in the dialect it was read in, atomically.

    Raises:
        InputError: the place cannot be written to.
    """
    write_json(path, to_specification(pattern))

"""The one kind of data carrier: a frozen dataclass that is also a JAX pytree."""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax

T = TypeVar("T")


def static(**kwargs: Any) -> Any:
    """A field that belongs to the tree's structure: hashable, and a new value means a new trace."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
def pytree(cls: type[T]) -> type[T]:
    """Make `cls` a frozen dataclass whose non-static fields are pytree children.

    Fields are data (arrays or further pytrees) unless declared with `static()`.
    """
    cls = dataclasses.dataclass(frozen=True, eq=False)(cls)
    fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    meta = [field.name for field in fields if field.metadata.get("static")]
    data = [field.name for field in fields if not field.metadata.get("static")]
    jax.tree_util.register_dataclass(cls, data_fields=data, meta_fields=meta)
    return cls


def replace(tree: T, **changes: Any) -> T:
    """A copy of a frozen pytree with some fields changed."""
    return dataclasses.replace(tree, **changes)  # type: ignore[type-var]

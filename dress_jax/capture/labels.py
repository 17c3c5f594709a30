"""Kinds of clothes in a picture or on a scan, and the tables that translate others' ids (S10.3).

Every table gives each id its name in that data set and our label. One-piece garments (dress,
jumpsuit) are `DRESS`; socks, hats, belts, bags, glasses, gloves, underwear are `OTHER`: a fit looks
at none of them, and leaves out the pixels that they cover (S10.4).
"""

import enum
from collections.abc import Mapping

import numpy as np
from jaxtyping import Int, UInt8

from dress_jax.core.errors import InputError


class ClothesLabel(enum.IntEnum):
    """What a pixel or a vertex shows."""

    BACKGROUND = 0
    SKIN = 1
    HAIR = 2
    TOP = 3
    BOTTOM = 4
    DRESS = 5
    SHOE = 6
    OTHER = 7


CLOTHES = (ClothesLabel.TOP, ClothesLabel.BOTTOM, ClothesLabel.DRESS)
"""What can be fitted, from the top down."""

LABEL_COLORS = np.array(
    [
        [255, 255, 255],
        [232, 190, 160],
        [90, 60, 40],
        [60, 120, 200],
        [40, 150, 110],
        [200, 70, 110],
        [120, 90, 160],
        [235, 190, 60],
    ],
    np.uint8,
)
"""Colour of each label in pictures, shape (8, 3)."""

_B, _S, _H = ClothesLabel.BACKGROUND, ClothesLabel.SKIN, ClothesLabel.HAIR
_T, _L, _D = ClothesLabel.TOP, ClothesLabel.BOTTOM, ClothesLabel.DRESS
_F, _O = ClothesLabel.SHOE, ClothesLabel.OTHER

LabelTable = Mapping[int, tuple[str, ClothesLabel]]


def _table(*entries: tuple[str, ClothesLabel]) -> LabelTable:
    return dict(enumerate(entries))


# fmt: off
TABLES: Mapping[str, LabelTable] = {
    "own": {int(label): (label.name.lower(), label) for label in ClothesLabel},
    "atr": _table(
        ("background", _B), ("hat", _O), ("hair", _H), ("sunglasses", _O), ("upper-clothes", _T),
        ("skirt", _L), ("pants", _L), ("dress", _D), ("belt", _O), ("left-shoe", _F),
        ("right-shoe", _F), ("face", _S), ("left-leg", _S), ("right-leg", _S), ("left-arm", _S),
        ("right-arm", _S), ("bag", _O), ("scarf", _O),
    ),
    "lip": _table(
        ("background", _B), ("hat", _O), ("hair", _H), ("glove", _O), ("sunglasses", _O),
        ("upper-clothes", _T), ("dress", _D), ("coat", _T), ("socks", _O), ("pants", _L),
        ("jumpsuits", _D), ("scarf", _O), ("skirt", _L), ("face", _S), ("left-arm", _S),
        ("right-arm", _S), ("left-leg", _S), ("right-leg", _S), ("left-shoe", _F),
        ("right-shoe", _F),
    ),
    "fashn": _table(
        ("background", _B), ("face", _S), ("hair", _H), ("top", _T), ("dress", _D), ("skirt", _L),
        ("pants", _L), ("belt", _O), ("bag", _O), ("hat", _O), ("scarf", _O), ("glasses", _O),
        ("arms", _S), ("hands", _S), ("legs", _S), ("feet", _S), ("torso", _S), ("jewelry", _O),
    ),
    "sapiens": _table(
        ("background", _B), ("apparel", _O), ("face-neck", _S), ("hair", _H), ("left-foot", _S),
        ("left-hand", _S), ("left-lower-arm", _S), ("left-lower-leg", _S), ("left-shoe", _F),
        ("left-sock", _O), ("left-upper-arm", _S), ("left-upper-leg", _S), ("lower-clothing", _L),
        ("right-foot", _S), ("right-hand", _S), ("right-lower-arm", _S), ("right-lower-leg", _S),
        ("right-shoe", _F), ("right-sock", _O), ("right-upper-arm", _S), ("right-upper-leg", _S),
        ("torso", _S), ("upper-clothing", _T), ("lower-lip", _S), ("upper-lip", _S),
        ("lower-teeth", _S), ("upper-teeth", _S), ("tongue", _S),
    ),
    "close": _table(
        ("hat", _O), ("body", _S), ("shirt", _T), ("t-shirt", _T), ("vest", _T), ("coat", _T),
        ("dress", _D), ("skirt", _L), ("pants", _L), ("short pants", _L), ("shoes", _F),
        ("hoodies", _T), ("hair", _H), ("swimwear", _O), ("underwear", _O), ("scarf", _O),
        ("jumpsuits", _D), ("jacket", _T),
    ),
    "4d-dress": _table(
        ("skin", _S), ("hair", _H), ("shoe", _F), ("upper", _T), ("lower", _L), ("outer", _T),
    ),
}
# fmt: on
"""Ids, their names and our label, by the name of the data set or the network's training set."""


def label_table(name: str) -> LabelTable:
    """A table of `TABLES`.

    Raises:
        InputError: there is none of that name.
    """
    if name not in TABLES:
        raise InputError(
            f"there is no label table '{name}'",
            where="label table",
            mend=f"give one of {', '.join(TABLES)}",
        )
    return TABLES[name]


def convert_labels(ids: Int[np.ndarray, "*shape"], table: str) -> UInt8[np.ndarray, "*shape"]:
    """Our labels of others' ids.

    Args:
        ids: whole numbers, any shape.
        table: a key of `TABLES`.

    Raises:
        InputError: there is no such table, the ids are no whole numbers, or the table lacks one
            of them; the message names it.
    """
    known = label_table(table)
    ids = np.asarray(ids)
    if ids.dtype.kind not in "iu":
        raise InputError(
            f"labels are {ids.dtype}, not whole numbers",
            where=f"label table '{table}'",
            mend="give the ids themselves, not colours or scores",
        )
    unknown = sorted(int(i) for i in np.unique(ids) if int(i) not in known)
    if unknown:
        raise InputError(
            f"does not know id {', '.join(map(str, unknown[:5]))}"
            + (f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""),
            where=f"label table '{table}'",
            mend=f"its ids are 0 to {max(known)}; name the table that the labels were made with",
        )
    lookup = np.zeros(max(known) + 1, np.uint8)
    for number, (_, label) in known.items():
        lookup[number] = label
    return lookup[ids]


def clothes_masks(labels: UInt8[np.ndarray, "h w"]) -> dict[str, UInt8[np.ndarray, "h w"]]:
    """The mask of each kind of clothes that occurs, 0 or 255, from the top down (S10.3)."""
    masks = {kind.name.lower(): 255 * (labels == kind).astype(np.uint8) for kind in CLOTHES}
    return {name: mask for name, mask in masks.items() if mask.any()}


def hidden_by(labels: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Where hair and accessories may hide clothes (M^alpha, S10.4), 0 or 255."""
    return 255 * np.isin(labels, [ClothesLabel.HAIR, ClothesLabel.OTHER]).astype(np.uint8)

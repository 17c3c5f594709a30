"""Distances between the outlines of two masks along rows and columns, linearized. Host, numpy.

Between an outline of the drawn mask and one of the target lies a run of pixels that only one of the
masks has. Its length is what the drawn outline has to move, and half its square what that costs. A
run between two outlines of the drawn mask, such as a gap between two legs that touch in the target,
closes from both ends; one between two outlines of the target costs and pulls nothing. Such runs
count along the line on which they are shorter: a strip beside a skirt that is too wide is closed by
its side, and not by its hem.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int


@dataclasses.dataclass(frozen=True, eq=False)
class Target:
    """One mask to compare with.

    Attributes:
        mask: coverage in [0, 1], (h, w).
        valid: where the mask is known, (h, w).
    """

    mask: Float[np.ndarray, "h w"]
    valid: Bool[np.ndarray, "h w"]

    @functools.cached_property
    def rows(self) -> "_Known":
        """The mask along its rows."""
        return _target_lines(self, vertical=False)

    @functools.cached_property
    def columns(self) -> "_Known":
        """The mask along its columns."""
        return _target_lines(self, vertical=True)

    @functools.cached_property
    def length(self) -> int:
        """Number of places where its outline crosses rows or columns."""
        return sum(int(np.sum(own.lines.changes & own.known)) for own in (self.rows, self.columns))


class Drawn(NamedTuple):
    """The outline of a drawn garment in one view; see `render.contours.Contour`."""

    along: Float[np.ndarray, " q"]
    line: Int[np.ndarray, " q"]
    before: Int[np.ndarray, " q"]
    vertical: Bool[np.ndarray, " q"]
    vertices: Int[np.ndarray, "q 2"]
    slope: Float[np.ndarray, "q 2 3"]
    inside: Bool[np.ndarray, "h w"]


class Rows(NamedTuple):
    """Residuals that are linear in the vertices.

    Attributes:
        residual: distance [m], (r,).
        jacobian: its derivative in the flattened positions, (r, 3 n).
        weight: share of each residual in the mean, (r,).
    """

    residual: Float[np.ndarray, " r"]
    jacobian: scipy.sparse.csr_array
    weight: Float[np.ndarray, " r"]


def outline_rows(
    targets: Sequence[Target],
    drawn: Sequence[Drawn],
    metres_per_pixel: Float[np.ndarray, " v"],
    vertex_count: int,
) -> Rows:
    """Distances between drawn and target outlines of all views.

    The mean is over views, and in each over the target's outline. A view without any is left out,
    and so are runs that touch unknown pixels or the border of the image.

    Args:
        targets: mask of every view.
        drawn: outline of the garment in every view.
        metres_per_pixel: at the garment's distance, for every view.
        vertex_count: n.
    """
    residuals, weights, triples, count = [], [], [], 0
    lengths = [target.length for target in targets]
    views = sum(length > 0 for length in lengths)
    for target, outline, metres, length in zip(
        targets, drawn, metres_per_pixel, lengths, strict=True
    ):
        if not length:
            continue
        for vertical in (False, True):
            runs, lonely = _runs(target, outline, vertical=vertical)
            residuals += [metres * runs.distance, metres * lonely]
            size = len(runs.distance) + len(lonely)
            weights.append(np.full(size, 1.0 / (views * length)))
            entries = metres * (runs.share[:, None, None] * outline.slope[runs.crossing])
            columns = 3 * outline.vertices[runs.crossing][:, :, None] + np.arange(3)
            rows = count + np.arange(len(runs.distance))[:, None, None]
            rows = np.broadcast_to(rows, columns.shape)
            triples.append((entries.ravel(), rows.ravel(), columns.ravel()))
            count += size
    shape = (count, 3 * vertex_count)
    if not triples:
        return Rows(np.zeros(0), scipy.sparse.csr_array(shape), np.zeros(0))
    entries, rows, columns = (np.concatenate(part) for part in zip(*triples, strict=True))
    moving = entries != 0.0  # the occluder's outlines name vertices that are not the garment's
    jacobian = scipy.sparse.csr_array(
        (entries[moving], (rows[moving], columns[moving])), shape=shape
    )
    return Rows(np.concatenate(residuals), jacobian, np.concatenate(weights))


class _Runs(NamedTuple):
    """Runs that begin at a drawn outline: which crossing, its distance [px], and the derivative of
    the distance in the crossing."""

    crossing: Int[np.ndarray, " r"]
    distance: Float[np.ndarray, " r"]
    share: Float[np.ndarray, " r"]


class _Lines(NamedTuple):
    """A mask along lines: where it changes, and the places of the changes on either side.

    `place` is the coordinate of a change between a pixel and the next one; `following` and
    `preceding` are the nearest changes from a place on, itself included, or the number of places
    and -1 where there is none.
    """

    inside: Bool[np.ndarray, "l m"]
    changes: Bool[np.ndarray, "l k"]
    place: Float[np.ndarray, "l k"]
    following: Int[np.ndarray, "l k"]
    preceding: Int[np.ndarray, "l k"]


def _lines(inside: Bool[np.ndarray, "l m"], place: Float[np.ndarray, "l k"]) -> _Lines:
    changes = inside[:, :-1] != inside[:, 1:]
    number = np.broadcast_to(np.arange(changes.shape[1]), changes.shape)
    following = np.where(changes, number, changes.shape[1])
    preceding = np.where(changes, number, -1)
    return _Lines(
        inside,
        changes,
        place,
        np.minimum.accumulate(following[:, ::-1], axis=1)[:, ::-1],
        np.maximum.accumulate(preceding, axis=1),
    )


class _Known(NamedTuple):
    """A target along lines: where it is known, and where an outline crosses rather than runs along,
    both between neighbours."""

    lines: _Lines
    known: Bool[np.ndarray, "l k"]
    steep: Bool[np.ndarray, "l k"]


def _target_lines(target: Target, *, vertical: bool) -> _Known:
    mask = np.asarray(target.mask, np.float64)
    mask, valid = (mask.T, target.valid.T) if vertical else (mask, target.valid)
    inside = mask > 0.5
    # What both pixels hold of the garment lies side by side: exact for an edge across the line.
    covered = mask[:, :-1] + mask[:, 1:]
    place = np.arange(covered.shape[1]) + np.where(inside[:, :-1], covered - 0.5, 1.5 - covered)
    return _Known(
        _lines(inside, place), valid[:, :-1] & valid[:, 1:], _steep(target, vertical=vertical)
    )


def _runs(target: Target, drawn: Drawn, *, vertical: bool) -> tuple[_Runs, Float[np.ndarray, " s"]]:
    """Runs along rows or columns: from the drawn outline, and halves of those without any [px]."""
    wanted, known, steep = target.columns if vertical else target.rows
    inside = drawn.inside.T if vertical else drawn.inside
    middle = np.broadcast_to(np.arange(known.shape[1]) + 0.5, known.shape)
    own = _lines(inside, middle)

    crossing = np.nonzero(drawn.vertical == vertical)[0]
    line, before, along = drawn.line[crossing], drawn.before[crossing], drawn.along[crossing]
    longest = _crosswise(inside != (target.mask.T > 0.5 if vertical else target.mask > 0.5))
    ends, ended, by_target = _ends(line, before, wanted, own, longest)
    usable = known[line, before] & ended
    end = np.where(usable, ends, 0)
    usable &= known[line, end]
    place = np.where(by_target, wanted.place[line, end], own.place[line, end])
    share = np.where(by_target, 1.0, 0.5)
    distance = share * (along - place)
    runs = _Runs(crossing[usable], distance[usable], share[usable])

    line, before = np.nonzero(wanted.changes & known & ~own.changes & steep)
    ends, ended, by_target = _ends(line, before, wanted, own, longest, start_is_target=True)
    usable = ended & by_target
    usable &= known[line, np.where(usable, ends, 0)]
    line, before, end = line[usable], before[usable], ends[usable]
    return runs, 0.5 * (wanted.place[line, before] - wanted.place[line, end])


def _ends(
    line: Int[np.ndarray, " r"],
    before: Int[np.ndarray, " r"],
    wanted: _Lines,
    own: _Lines,
    longest: Int[np.ndarray, "l m"],
    *,
    start_is_target: bool = False,
) -> tuple[Int[np.ndarray, " r"], Bool[np.ndarray, " r"], Bool[np.ndarray, " r"]]:
    """Where the runs end that begin at some changes of either mask.

    Args:
        line, before: the changes.
        wanted, own: the masks along lines.
        longest: length of the runs across the lines through every pixel.
        start_is_target: whether the changes are the target's, and not of the drawn mask.

    Returns:
        The change at the other end; whether there is one, and the run counts on this line; and
        whether it is one of the target. A drawn and a target change in the same place make a run of
        less than a pixel.
    """
    size = wanted.changes.shape[1]
    ahead = own.inside[line, before + 1] != wanted.inside[line, before + 1]
    step = np.where(ahead, 1, -1)
    beyond = before + step
    within = (beyond >= 0) & (beyond < size)
    place = np.clip(beyond, 0, size - 1)

    def nearest(lines: _Lines) -> Int[np.ndarray, " r"]:
        found = np.where(ahead, lines.following[line, place], lines.preceding[line, place])
        return np.where(within, found, np.where(ahead, size, -1))

    target, drawn = nearest(wanted), nearest(own)
    by_target = step * target <= step * drawn
    end = np.where(by_target, target, drawn)
    ended = (end >= 0) & (end < size)
    lone = by_target if start_is_target else ~by_target
    ended &= ~lone | (np.abs(end - before) <= longest[line, before + ahead])
    if not start_is_target:
        here = wanted.changes[line, before]
        end, ended, by_target = np.where(here, before, end), ended | here, by_target | here
    return end, ended, by_target


def _crosswise(different: Bool[np.ndarray, "l m"]) -> Int[np.ndarray, "l m"]:
    """For every set pixel the number of set pixels in a row through it, across the lines."""
    number = np.arange(len(different))[:, None]
    before = np.maximum.accumulate(np.where(different, -1, number), axis=0)
    after = np.minimum.accumulate(np.where(different, len(different), number)[::-1], axis=0)[::-1]
    return after - before - 1


def _steep(target: Target, *, vertical: bool) -> Bool[np.ndarray, "l k"]:
    """Between which neighbours on rows (columns) an outline crosses rather than runs along."""
    mask = np.asarray(target.mask, np.float64)
    rows, columns = (np.abs(g) for g in np.gradient(mask))
    across, along = (rows.T, columns.T) if vertical else (columns, rows)
    return across[:, :-1] + across[:, 1:] >= along[:, :-1] + along[:, 1:]

"""Distances between outlines along pixel lines, on masks made of rectangles."""

import numpy as np
import pytest

from dress_jax.optimisation.gauss_newton.outline import Drawn, Target, outline_rows

SIZE = 40
METRES = 0.01


def rectangle(left, right, top, bottom):
    """Coverage of the pixels around whole-number centres by a rectangle."""
    edges = np.arange(SIZE + 1) - 0.5

    def part(low, high):
        return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0, 1.0)

    return part(top, bottom)[:, None] * part(left, right)[None, :]


def target(mask, valid=None):
    return Target(mask, np.ones(mask.shape, bool) if valid is None else valid)


def outline_of(boxes, *, rows=True, columns=True):
    """The outline of disjoint rectangles; side k of the i-th one hangs on vertex 4 i + k, whose x
    moves it along its line by one pixel per metre."""
    inside = np.zeros((SIZE, SIZE), bool)
    found = []
    for number, (left, right, top, bottom) in enumerate(boxes):
        inside |= rectangle(left, right, top, bottom) > 0.5
        lines = {
            False: (range(int(np.ceil(top)), int(bottom) + 1), (left, right)),
            True: (range(int(np.ceil(left)), int(right) + 1), (top, bottom)),
        }
        for vertical, (numbers, places) in lines.items():
            if (vertical and not columns) or (not vertical and not rows):
                continue
            for k, place in enumerate(places):
                found += [(place, n, vertical, 4 * number + 2 * vertical + k) for n in numbers]
    along, line, vertical, vertex = (np.array(part) for part in zip(*found, strict=True))
    slope = np.zeros((len(along), 2, 3))
    slope[:, 0, 0] = 1.0
    return Drawn(
        along=along,
        line=line,
        before=np.floor(along).astype(int),
        vertical=vertical.astype(bool),
        vertices=np.stack([vertex, vertex], axis=1),
        slope=slope,
        inside=inside,
    )


def solve(wanted, drawn, count):
    rows = outline_rows([wanted], [drawn], np.array([METRES]), count)
    return rows, rows.jacobian.toarray()[:, ::3]


BOX = (10.2, 20.7, 8.5, 30.5)
"""Left, right, top, bottom [px]; rows are covered whole or not at all."""


def test_equal_masks_are_at_no_distance():
    rows, jacobian = solve(target(rectangle(*BOX)), outline_of([BOX]), 4)
    assert np.abs(rows.residual).max() < 1e-12
    assert np.sum(rows.weight) == pytest.approx(1.0)
    assert np.abs(jacobian).max() == pytest.approx(METRES)


@pytest.mark.parametrize(
    ("shift", "down"), [(-6.4, 0.0), (-0.3, 0.0), (0.4, -4.0), (5.6, -4.0), (0.0, 6.0)]
)
def test_one_step_moves_every_side_to_its_place(shift, down):
    """Residuals are linear over any distance, so one solve ends at the target."""
    left, right, top, bottom = BOX
    drawn = outline_of([(left + shift, right, top, bottom + down)])
    rows, jacobian = solve(target(rectangle(*BOX)), drawn, 4)
    steps = -np.linalg.lstsq(jacobian, rows.residual, rcond=None)[0]
    np.testing.assert_allclose(steps, [-shift, 0.0, 0.0, -down], atol=1e-9)


def test_a_gap_closes_from_both_sides():
    """Two legs that touch in the target: each moves by half of the gap."""
    left, right, top, bottom = BOX
    halves = [(left, 12.5, top, bottom), (16.0, right, top, bottom)]
    drawn = outline_of(halves, columns=False)
    rows, jacobian = solve(target(rectangle(*BOX)), drawn, 8)
    steps = -np.linalg.lstsq(jacobian, rows.residual, rcond=None)[0]
    assert steps[0] == pytest.approx(0.0, abs=1e-9)
    # Both together close the gap; where the far end lies is known to half a pixel.
    assert steps[1] - steps[4] == pytest.approx(2.0 * 3.5, abs=1.0)
    assert steps[1] == pytest.approx(-steps[4], abs=0.6)
    assert steps[5] == pytest.approx(0.0, abs=1e-9)


def test_what_only_the_target_has_costs_and_pulls_nothing():
    island = np.maximum(rectangle(*BOX), rectangle(26.0, 32.0, 9.5, 20.5))
    rows, jacobian = solve(target(island), outline_of([BOX]), 4)
    lonely = np.abs(rows.residual) > 1e-9
    assert lonely.any()
    assert not np.any(jacobian[lonely])
    # From both ends, each with half of the run.
    np.testing.assert_allclose(np.abs(rows.residual[lonely]), 0.03)


def test_unknown_pixels_do_not_count():
    left, right, top, bottom = BOX
    valid = np.ones((SIZE, SIZE), bool)
    valid[:, :16] = False
    drawn = outline_of([(left + 3.0, right, top, bottom)], columns=False)
    rows, jacobian = solve(target(rectangle(*BOX), valid), drawn, 4)
    assert np.abs(rows.residual).max() < 1e-12
    assert not np.any(jacobian[:, 0]) and np.any(jacobian[:, 1])


def test_the_border_of_the_image_is_no_outline():
    """A garment that leaves the picture in the target only."""
    wide = target(rectangle(-5.0, 20.7, 8.3, 30.4))
    rows, jacobian = solve(wide, outline_of([BOX], columns=False), 4)
    assert not np.any(jacobian[:, 0])
    assert np.abs(rows.residual).max() < 0.2 * METRES  # at the corners of the rectangle


def test_views_without_a_garment_are_left_out():
    empty = target(np.zeros((SIZE, SIZE)))
    drawn, metres = outline_of([BOX]), np.full(2, METRES)
    rows = outline_rows([empty, target(rectangle(*BOX))], [drawn, drawn], metres, 4)
    assert np.sum(rows.weight) == pytest.approx(1.0)
    nothing = outline_rows([empty], [drawn], metres[:1], 4)
    assert nothing.residual.shape == (0,) and nothing.jacobian.shape == (0, 12)

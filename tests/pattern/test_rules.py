"""Design rules: what they measure, their derivatives, and rules that cannot be read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.pattern import Panel, Pattern, edge_table, pattern_parameters
from dress_jax.pattern.model import Edge, EdgeKind, line, quadratic
from dress_jax.pattern.rules import (
    OwnRule,
    equal_lengths,
    fixed_edge,
    gaps,
    minimum_length,
    minimum_width,
    parse_rules,
    right_angle,
)


@pytest.fixture(scope="module")
def pattern():
    """A trapezoid with an arc and a quadratic, and a unit square."""
    corners = np.array([(0.0, 0.0), (0.6, 0.0), (0.5, 0.4), (0.1, 0.4)])
    arc = Edge(EdgeKind.ARC, 2, 3, np.array([[0.5, 0.1]]))
    edges = (quadratic(0, 1, (0.5, -0.1)), line(1, 2), arc, line(3, 0))
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    sides = (line(0, 1), line(1, 2), line(2, 3), line(3, 0))
    place = {"rotation": np.eye(3), "translation": np.zeros(3)}
    return Pattern(
        panels=(
            Panel(name="skirt", vertices=corners, edges=edges, **place),
            Panel(name="band", vertices=square, edges=sides, **place),
        ),
        source="two panels",
    )


@pytest.fixture(scope="module")
def rules(pattern):
    return (
        fixed_edge(pattern, "skirt", 0),
        fixed_edge(pattern, "skirt", 2),
        equal_lengths(pattern, [("skirt", 1), ("skirt", 3), ("band", 0)]),
        minimum_length(pattern, "skirt", 0, 0.5),
        minimum_width(pattern, "band", 1.2),
        right_angle(pattern, "skirt", 1),
        right_angle(pattern, "band", 0),
    )


def test_gaps_are_what_their_names_say(pattern, rules):
    start, edges = pattern_parameters(pattern), edge_table(pattern)
    own = [np.asarray(rule.gap(start, edges)) for rule in rules]
    np.testing.assert_allclose(np.concatenate(own[:2]), 0.0, atol=1e-15)
    side = np.hypot(0.1, 0.4)
    np.testing.assert_allclose(own[2], [0.0, 1.0 - side], atol=1e-12)
    assert own[3] > 0.1 and rules[3].at_least
    np.testing.assert_allclose(own[4], -0.2)
    # The quadratic arrives along (1, 0.2), the side leaves along (-0.1, 0.4).
    expected = np.dot([1.0, 0.2], [-0.1, 0.4]) / np.hypot(1.0, 0.2) / np.hypot(0.1, 0.4)
    np.testing.assert_allclose(own[5], expected, atol=1e-12)
    np.testing.assert_allclose(own[6], 0.0, atol=1e-15)
    moved = replace(start, vertices=start.vertices.at[1, 0].add(0.03))
    np.testing.assert_allclose(rules[0].gap(moved, edges)[0], 0.03)
    bent = replace(start, controls=start.controls.at[0, 1].add(0.1))
    np.testing.assert_allclose(rules[0].gap(bent, edges), [0.0, 0.0, 0.06], atol=1e-12)


def test_derivatives(pattern, rules):
    edges, rng = edge_table(pattern), np.random.default_rng(3)
    start = jax.tree.map(
        lambda x: x + 0.02 * jnp.asarray(rng.normal(size=x.shape)), pattern_parameters(pattern)
    )
    count = len(gaps(rules, start, edges))
    weights = jnp.asarray(rng.normal(size=count))

    def value(p):
        return jnp.sum(weights * gaps(rules, p, edges))

    check_grads(jax.jit(value), (start,), order=1, modes=("fwd", "rev"), rtol=1e-5)
    slopes = jax.jit(jax.jacrev(lambda p: gaps(rules, p, edges)))(start)
    size = np.abs(slopes.vertices).max(axis=(1, 2)) + np.abs(slopes.controls).max(axis=(1, 2))
    assert size.min() > 1e-3


def test_a_rule_of_ones_own(pattern):
    edges = edge_table(pattern)
    rule = OwnRule("centred", lambda p, e: jnp.mean(p.vertices[:4, 0]))
    np.testing.assert_allclose(rule.gap(pattern_parameters(pattern), edges), [0.3])


def test_rules_of_a_document(pattern, rules):
    document = {
        "rules": [
            {"rule": "fixed", "panel": "skirt", "edge": 0},
            {"rule": "fixed", "panel": "skirt", "edge": 2},
            {"rule": "equal", "edges": [["skirt", 1], ["skirt", 3], ["band", 0]]},
            {"rule": "minimum-length", "panel": "skirt", "edge": 0, "length_cm": 50},
            {"rule": "minimum-width", "panel": "band", "width_cm": 120},
            {"rule": "right-angle", "panel": "skirt", "edge": 1},
            {"rule": "right-angle", "panel": "band", "edge": 0},
        ]
    }
    read = parse_rules(document, pattern, where="rules.json")
    assert read == rules and hash(read) == hash(rules)


@pytest.mark.parametrize(
    "entry, message",
    [
        ({"rule": "curly"}, "'curly' is no rule"),
        (7, "None is no rule"),
        ({"rule": "fixed", "panel": "skirt"}, r"missing or too many: \['edge'\]"),
        ({"rule": "fixed", "panel": "hood", "edge": 0}, "no panel 'hood'"),
        ({"rule": "fixed", "panel": "band", "edge": 4}, "no edge 4"),
        ({"rule": "fixed", "panel": "band", "edge": True}, "no edge True"),
        ({"rule": "equal", "edges": [["band", 0]]}, "at least two"),
        ({"rule": "equal", "edges": "band"}, "no list of"),
        ({"rule": "minimum-width", "panel": "band", "width_cm": -3}, "no positive length"),
        ({"rule": "minimum-width", "panel": "band", "width_cm": "3"}, "no number"),
    ],
)
def test_rules_that_are_none(pattern, entry, message):
    with pytest.raises(InputError, match=rf"rules.json, rule 0.*{message}"):
        parse_rules({"rules": [entry]}, pattern, where="rules.json")
    with pytest.raises(InputError, match="no list 'rules'"):
        parse_rules({}, pattern, where="rules.json")

"""Sewing patterns: the object, its file dialects as dictionaries, parameters, discretization."""

from dress_jax.pattern.build import discretize as discretize
from dress_jax.pattern.discretization import Discretization as Discretization
from dress_jax.pattern.discretization import components as components
from dress_jax.pattern.discretization import placed_positions as placed_positions
from dress_jax.pattern.discretization import rest_positions as rest_positions
from dress_jax.pattern.discretization import samples_of_edge as samples_of_edge
from dress_jax.pattern.drawing import drawing as drawing
from dress_jax.pattern.model import Dialect as Dialect
from dress_jax.pattern.model import Edge as Edge
from dress_jax.pattern.model import EdgeKind as EdgeKind
from dress_jax.pattern.model import Panel as Panel
from dress_jax.pattern.model import Pattern as Pattern
from dress_jax.pattern.model import Side as Side
from dress_jax.pattern.model import Stitch as Stitch
from dress_jax.pattern.parameters import EdgeTable as EdgeTable
from dress_jax.pattern.parameters import PatternParameters as PatternParameters
from dress_jax.pattern.parameters import edge_lengths as edge_lengths
from dress_jax.pattern.parameters import edge_table as edge_table
from dress_jax.pattern.parameters import pattern_parameters as pattern_parameters
from dress_jax.pattern.parameters import with_parameters as with_parameters
from dress_jax.pattern.scaling import scaled as scaled
from dress_jax.pattern.specification import parse_specification as parse_specification
from dress_jax.pattern.specification_writer import to_specification as to_specification

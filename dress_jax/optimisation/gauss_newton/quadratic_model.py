"""The quadratic model of the cost, which everything that is compared adds to."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Model(NamedTuple):
    """A quadratic model of the cost around some unknowns."""

    gradient: Float[np.ndarray, " k"]
    matrix: Float[np.ndarray, "k k"]

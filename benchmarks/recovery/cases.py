"""Which patterns, bodies, starts and observations: the cases of the recovery benchmark."""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping

from benchmarks.recovery.variants import WHOLE

PATTERNS = (
    "tshirt",
    "fitted_shirt_long",
    "tank_top",
    "strapless_top",
    "circle_skirt",
    "godet_skirt",
    "flare_skirt_manypanel",
    "pants_long",
    "pants_cuffed",
    "jumpsuit",
    "dress_sleeves",
    "skirt2_ruffle",
)
"""Of GarmentCode, without `_specification.json`."""

BODIES: Mapping[str, Mapping[str, str]] = {
    "drafted": {"body": "mean_all.obj"},
    "default": {
        "body": "default",
        "pose": "a",
        "shape": "height=1.7199,bust=0.9984,waist=0.8433,hips=1.0348",
    },
}
"""The body for which the patterns were drafted, and the default one with its measurements."""


@dataclasses.dataclass(frozen=True)
class Start:
    """How wrong a fit begins.

    Attributes:
        width, length: factors on every panel.
        noise: standard deviation of its corners [m].
    """

    width: float
    length: float
    noise: float = 0.0


STARTS: Mapping[str, Start] = {
    "10%": Start(1.10, 0.90),
    "25%": Start(1.25, 0.75),
    "long": Start(1.00, 1.50),
    "bad": Start(1.30, 0.65, 0.01),
}
"""Wider and shorter, half as long again, and one that no predictor would dare: for long runs."""

STIFFNESS = (1.5, 0.5)
"""Factors on stretching and bending with which a fit begins; the truth is 1."""


@dataclasses.dataclass(frozen=True)
class View:
    """What a fit may see.

    Attributes:
        views: number of cameras.
        size: of the pictures [px].
        erosion: of the masks [px].
        normal_noise: standard deviation of the normals' tilt [degrees].
    """

    views: int = 20
    size: int = 512
    erosion: int = 0
    normal_noise: float = 0.0


VIEWS: Mapping[str, View] = {
    "clean": View(),
    "eroded": View(erosion=3),
    "noisy": View(normal_noise=10.0),
    "few": View(views=8),
    "small": View(views=12, size=256),
}
"""The clean observation, three degraded ones, and one for quick comparisons."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One recovery.

    Attributes:
        pattern, body, start, view: keys of the tables above.
        variant: key of `variants.VARIANTS`.
    """

    pattern: str
    body: str
    start: str
    view: str
    variant: str = WHOLE

    @property
    def name(self) -> str:
        """For files and tables."""
        whole = f"{self.pattern}@{self.body}-{self.start.rstrip('%')}-{self.view}"
        return whole if self.variant == WHOLE else f"{whole}+{self.variant}"


def cases(
    patterns: tuple[str, ...],
    bodies: tuple[str, ...],
    starts: tuple[str, ...],
    views: tuple[str, ...],
    variants: tuple[str, ...],
) -> Iterator[Case]:
    """All combinations, the clean ones of every pattern first."""
    for view, start, body, pattern, variant in itertools.product(
        views, starts, bodies, patterns, variants
    ):
        yield Case(pattern, body, start, view, variant)

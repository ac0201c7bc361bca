"""Dispersions: distributions of scenario values that differ from case to case.

A dispersion names a scenario value by its dotted path and a distribution. The drawn number replaces the value
(``mode = "absolute"``), is added to it (``"offset"``) or multiplies it (``"factor"``)::

    [dispersions."gyro.true_G.0.0"]
    kind = "normal"
    sigma = 5e-4
    mode = "offset"

Every sampler yields one number u of (0, 1) per case and path, and the distribution's quantile function turns it into the
draw. Each path has its own one-dimensional sequence, so that one more dispersion changes none of the others:

- ``random``: u from the case's stream "dispersions/<path>".
- ``lhs``: Latin hypercube, for each path a stratified permutation of the cases. Rows depend on the number of cases.
- ``sobol``: dimension k of a Sobol sequence for the k-th path declared, each with its own scrambling. Two entropies scramble
  the same sequence: their estimates are independent, but case i of the one is not independent of case i of the other.

Correlations join the draws of some paths by a Gaussian copula: with their correlation matrix C = L Lᵀ and z = Φ⁻¹(u) of each
path, u becomes Φ(L z). Each path keeps its distribution, and normal ones have the covariance C_ij σ_i σ_j. The first path of a
group and all paths outside keep their draws.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import repeat
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator
from scipy.special import ndtr, ndtri

from gyrocal.arrays import Array
from gyrocal.errors import InputError, suggest_names
from simulator.scenario import Scenario, override
from simulator.streams import generator

Sampler = Literal["random", "lhs", "sobol"]

SMALLEST_U = 2.0**-54  # half a unit of a random double: keeps the quantiles finite
SOBOL_BITS = 32  # as many cases as there are case numbers
SMALLEST_EIGENVALUE = 1e-9  # of a correlation matrix: below it the Cholesky factor is rounding
SOBOL_BLOCK = 1024  # rows of one draw; a power of two, which the sequence needs


class _Distribution(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    mode: Literal["absolute", "offset", "factor"] = "absolute"

    def apply_draw(self, draw: float, value: float) -> float:
        """Return the dispersed value of the scenario."""
        return draw if self.mode == "absolute" else value + draw if self.mode == "offset" else value * draw


class Normal(_Distribution):
    """Normal distribution."""

    kind: Literal["normal"]
    mean: float = 0.0
    sigma: float = Field(gt=0)

    def quantile(self, u: float) -> float:
        """Return the draw below which a share u of all draws lies."""
        return float(self.mean + self.sigma * ndtri(u))


class _Range(_Distribution):
    low: float
    high: float

    @field_validator("high")
    @classmethod
    def _check_above_low(cls, value: float, info: ValidationInfo) -> float:
        if "low" in info.data and not value > info.data["low"]:
            raise ValueError("must be above low")
        return value


class Uniform(_Range):
    """Uniform distribution."""

    kind: Literal["uniform"]

    def quantile(self, u: float) -> float:
        """Return the draw below which a share u of all draws lies."""
        return self.low + (self.high - self.low) * u


class LogUniform(_Range):
    """Uniform in the logarithm."""

    kind: Literal["loguniform"]
    low: float = Field(gt=0)

    def quantile(self, u: float) -> float:
        """Return the draw below which a share u of all draws lies."""
        return float(np.exp(np.log(self.low) + (np.log(self.high) - np.log(self.low)) * u))


Dispersion = Annotated[Normal | Uniform | LogUniform, Field(discriminator="kind")]


class Correlation(BaseModel):
    """Correlation of dispersed parameters: a Gaussian copula; `matrix` correlates the underlying normal variables."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    paths: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _check_matrix(self) -> Self:
        size = len(self.paths)
        if size < 2 or len(self.matrix) != size or any(len(row) != size for row in self.matrix):
            raise ValueError(f"matrix: must have a row and a column for each of its {size} paths, at least two")
        matrix = np.array(self.matrix)
        if (matrix != matrix.T).any() or (np.diag(matrix) != 1).any():
            raise ValueError("matrix: must be symmetric, with ones on its diagonal")
        if np.linalg.eigvalsh(matrix)[0] < SMALLEST_EIGENVALUE:
            raise ValueError("matrix: must be positive definite; no numbers have these correlations")
        return self

    def correlate(self, shares: Array) -> Array:
        """Correlate independent numbers of (0, 1), in the order of the paths; the first is unchanged."""
        mixed = ndtr(np.linalg.cholesky(np.array(self.matrix)) @ ndtri(shares))
        return np.array([shares[0], *np.clip(mixed[1:], SMALLEST_U, 1 - 2 * SMALLEST_U)])


def draw_uniforms(paths: tuple[str, ...], sampler: Sampler, *, entropy: int, case: int, cases: int) -> Iterator[float]:
    """Draw one number of (0, 1) for each path, in the order of the paths."""
    for dimension, path in enumerate(paths):
        if sampler == "random":
            u = float(generator(entropy, case, f"dispersions/{path}").random())
        elif sampler == "lhs":
            u = float(_draw_hypercube(entropy, path, cases)[case])
        else:
            block, row = divmod(case, SOBOL_BLOCK)
            u = float(_generate_sobol(entropy, path, dimension, block)[row])
        yield max(u, SMALLEST_U)


@lru_cache(maxsize=64)
def _draw_hypercube(entropy: int, path: str, cases: int) -> Array:
    """Draw the path's column (cases,) of the Latin hypercube: one number in each of as many equal strata."""
    from scipy.stats import qmc  # only here: it costs every process 30 MB

    rng = generator(entropy, 0, f"dispersions lhs/{path}")
    return np.asarray(qmc.LatinHypercube(d=1, rng=rng).random(cases)[:, 0])


@lru_cache(maxsize=64)
def _generate_sobol(entropy: int, path: str, dimension: int, block: int) -> Array:
    """Generate SOBOL_BLOCK rows of one dimension of the Sobol sequence, scrambled from the path's own stream."""
    from scipy.stats import qmc  # only here: it costs every process 30 MB

    rng = generator(entropy, 0, f"dispersions sobol/{path}")
    engine = qmc.Sobol(d=dimension + 1, scramble=True, bits=SOBOL_BITS, rng=rng)
    if block:
        engine.fast_forward(block * SOBOL_BLOCK)
    # The scrambled points are multiples of 2^-32 and may be 0: the middles of their cells are not.
    return np.asarray(engine.random(SOBOL_BLOCK)[:, dimension]) + 0.5 ** (SOBOL_BITS + 1)


def get_scenario_value(scenario: Scenario, path: str) -> float:
    """Return the number at a dotted path of a scenario; `InputError` if there is none."""
    value: Any = scenario
    for key in path.split("."):
        if isinstance(value, BaseModel) and key in type(value).model_fields:
            value = getattr(value, key)
        elif isinstance(value, tuple) and key.isdecimal() and int(key) < len(value):
            value = value[int(key)]
        else:
            raise InputError(f"dispersions: {path}: the scenario has no such value; there is no {key!r}")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"dispersions: {path}: only a number can be dispersed, and this is {value!r:.60}")
    return float(value)


def check(dispersions: Mapping[str, Dispersion], scenario: Scenario, correlations: Sequence[Correlation] = ()) -> None:
    """Raise `InputError` if a dispersion cannot act on the scenario, or a correlated path is not dispersed or given twice.

    The scenario must be valid with every draw at its median.
    """
    correlated = [path for group in correlations for path in group.paths]
    for path in correlated:
        if path not in dispersions:
            raise InputError(f"correlations: {path}: is not dispersed; {suggest_names(path, dispersions)}")
        if correlated.count(path) > 1:
            raise InputError(f"correlations: {path}: stands twice; give all paths that it is correlated with in one matrix")
    for path, dispersion in dispersions.items():
        if not isinstance(dispersion, Normal | Uniform | LogUniform):
            raise InputError(f"dispersions: {path}: is no Dispersion; declare the field as dict[str, Dispersion]")
        if dispersion.mode == "factor" and get_scenario_value(scenario, path) == 0:
            raise InputError(f'dispersions: {path}: a factor leaves its value, 0, as it is; use mode = "offset"')
    override(scenario, _evaluate_quantiles(dispersions, scenario, repeat(0.5)))


def draw_values(config: Any, scenario: Scenario, case: int) -> dict[str, float]:
    """Draw the dispersed values of a scenario in one case of a study's configuration, by path."""
    paths, counts = tuple(config.dispersions), {"entropy": config.entropy, "case": case, "cases": config.cases}
    by_path = dict(zip(paths, draw_uniforms(paths, config.sampler, **counts), strict=True))
    for group in config.correlations:
        mixed = group.correlate(np.array([by_path[path] for path in group.paths]))
        by_path |= dict(zip(group.paths, mixed.tolist(), strict=True))
    return _evaluate_quantiles(config.dispersions, scenario, by_path.values())


def _evaluate_quantiles(dispersions: Mapping[str, Dispersion], scenario: Scenario, levels: Iterable[float]) -> dict[str, float]:
    """Evaluate the dispersed values, each at a quantile of its distribution, in the order of the dispersions."""
    return {
        path: dispersion.apply_draw(dispersion.quantile(level), get_scenario_value(scenario, path))
        for (path, dispersion), level in zip(dispersions.items(), levels, strict=False)
    }

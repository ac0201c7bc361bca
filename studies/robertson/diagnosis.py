"""R Table 3 diagnosed: what parts the simulated from the flown Mission Mode, by the common inference.

Observations are flown minus simulated of R Table 3's 18 numbers, in sigmas: the scatter of the windows, once for the simulated
and once for the flight's own finite record, and the printed digits. M0 is the nominal Mission Mode under R's own statistic. A
candidate's column is what its effect changes when it is flown in the same windows with the same noise. Effects that add in
quadrature, noises and what changes its sign along the orbit, are held by the square of their size, in which the numbers are
nearest to linear; an effect of either sign whose two sides differ is two candidates. What is there or not is a shift.

The rival is "unknown", a random difference of any size in all numbers, in a period's, or in one number. Beside the search over
all 18 numbers, whole periods are held out: sizes from two periods predict the third.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.inference.amplitudes import Fitted, fit
from diagnosis.inference.attribution import Attribution, attribute
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Explanation, Search
from diagnosis.model.folds import held_out
from diagnosis.model.groups import Group, placed
from diagnosis.model.linear import LinearModel, Parameters
from diagnosis.settings import DEFAULT
from simulator.mission_mode.config import MissionConfig
from simulator.mission_mode.effects import applied, parse
from studies.robertson.calendar import PERIODS
from studies.robertson.ground import DEG_H
from studies.robertson.ladder import HORIZON, LANDED, NOMINAL
from studies.robertson.windows import NUMBERS, Number, published, scatter, simulated, walked

Array = NDArray[np.float64]
Windows = Mapping[tuple[str, ...], pd.DataFrame]

DIGITS = {"attitude_accuracy_deg": 1e-3, "yaw_update_deg": 1e-2, "gyro_bias_std_deg_h": 1e-4}  # R Table 3's last ones
UNKNOWN = "unknown"
UNKNOWN_LIMITS = (0.3, 300.0)  # sigmas of a random difference
MOST_EFFECTS = 4
BEAM = 20
WALK_SIZE = 0.02  # deg/h/sqrt(day), that a walk's column is formed with
NOTHING = Explanation((), 0.0, float(np.log(DEFAULT.unlisted_share)))


@dataclass(frozen=True)
class Tried:
    """An effect as it was flown about the nominal.

    Attributes
    ----------
    effect, axis, unit : of the candidate
    size : flown
    squared : whether the amplitude is the square of the size
    switch : whether it is there or not
    limits : plausible range of the size
    setting : set of effects of the windows; empty for a walk of the bias, which is added to the nominal's
    """

    effect: str
    axis: str | None
    unit: str
    size: float
    limits: tuple[float, float]
    setting: tuple[str, ...] = ()
    squared: bool = True
    switch: bool = False


TRIALS = (
    Tried("horizon_noise", None, "deg", 0.0287, (0.003, 0.2), (HORIZON,)),
    Tried("horizon_season", "winter lower", "deg", 0.15, (0.02, 0.6), ("horizon_season=0.15",)),
    Tried("horizon_season", "winter higher", "deg", 0.15, (0.02, 0.6), ("horizon_season=-0.15",)),
    Tried("dss_transfer", "up", "1", 0.001, (1e-4, 0.01), ("dss_transfer=0.001",), squared=False),
    Tried("dss_transfer", "down", "1", 0.001, (1e-4, 0.01), ("dss_transfer=-0.001",), squared=False),
    Tried("cross_track", None, "km", 2.0, (0.2, 10.0), ("cross_track=2",)),
    Tried("bias_gain", None, "1", 0.3, (0.02, 0.6), ("bias_gain=1.3",), squared=False),
    *(Tried("gyro_walk", axis, "deg/h/sqrt(day)", WALK_SIZE, (0.001, 0.2)) for axis in "xyz"),
    Tried("late_filter_upload", None, "", 1.0, (0.0, 1.0), ("late_filter_upload=1",), switch=True),
    Tried("printed_coefficients", None, "", 1.0, (0.0, 1.0), LANDED[1:], switch=True),
    Tried("boresights level", None, "", 1.0, (0.0, 1.0), LANDED, switch=True),
)


@dataclass(frozen=True)
class Beside:
    """Further observations in the model of Table 3, and candidates that act on them alone.

    Attributes
    ----------
    names, blocks : (m,) of the observations, and what each belongs to
    y : (m,) flown less nominal, in sigmas
    changes : (m,) of each set of effects, in sigmas
    groups : candidates with columns (m, k)
    """

    names: tuple[str, ...] = ()
    blocks: tuple[str, ...] = ()
    y: Array = field(default_factory=lambda: np.zeros(0))
    changes: Mapping[tuple[str, ...], Array] = field(default_factory=dict)
    groups: tuple[Group, ...] = ()


ALONE = Beside()


@dataclass(frozen=True)
class Diagnosis:
    """What the numbers say.

    Attributes
    ----------
    attribution : of the common inference
    fitted : effects of the likeliest explanation
    closed : with whole periods held out; None where nothing listed was found
    left : (n,) flown minus simulated with the listed effects of the explanation, in sigmas; Table 3's 18 numbers first
    sigma : (18,) of a number of Table 3
    """

    attribution: Attribution
    fitted: tuple[Fitted, ...]
    closed: Closure | None
    left: Array
    sigma: Array

    @property
    def probabilities(self) -> dict[str, float]:
        """Of each candidate, the likeliest first."""
        out: dict[str, float] = {}
        for one in self.attribution.ranked:
            for label in one.labels:
                out[label] = out.get(label, 0.0) + one.probability
        return dict(sorted(out.items(), key=lambda item: -item[1]))


def diagnose(windows: Windows) -> Diagnosis:
    """Search, attribution, sizes and closure."""
    model, sigma = linear_model(windows)
    return concluded(model, sigma, sorted([*Search(model).explanations(), NOTHING], key=lambda one: -one.log_posterior))


def concluded(model: LinearModel, sigma: Array, weighed: list[Explanation]) -> Diagnosis:
    """The diagnosis that follows from explanations, the likeliest first."""
    attribution = attribute(model, weighed)
    members = list(weighed[0].members)
    fitted = tuple(fit(model, members)) if members else ()
    listed = [one for one in fitted if not one.effect.startswith(UNKNOWN)]
    explained = sum((one.contribution for one in listed), np.zeros(len(model.y)))
    closed = compute_closure(model, members) if listed else None
    return Diagnosis(attribution, fitted, closed, model.y - explained, sigma)


def linear_model(windows: Windows, beside: Beside = ALONE, most_effects: int = MOST_EFFECTS) -> tuple[LinearModel, Array]:
    """The model of R Table 3 about the nominal, other observations below it, and each of Table 3's sigmas (18,)."""
    rows = windows[NOMINAL]
    base, flight = _array(simulated(rows)), _array(published())
    relative = _array(scatter(rows))
    digits = np.array([DIGITS[parameter] for parameter, _, _ in NUMBERS]) / np.sqrt(12.0)
    sigma = np.sqrt((relative * base) ** 2 + (relative * flight) ** 2 + digits**2)
    more = len(beside.names)
    groups = [_group(one, windows, base, sigma, beside.changes.get(one.setting, np.zeros(more))) for one in TRIALS]
    groups += [_padded(group, after=more) for group in _rivals()]
    groups += [_padded(group, before=len(NUMBERS)) for group in beside.groups]
    y = np.concatenate([(flight - base) / sigma, beside.y])
    candidates, W = placed(groups, lambda columns: columns, DEFAULT, len(y))
    period = np.array([*(number[2] for number in NUMBERS), *beside.blocks])
    model = LinearModel(
        y=y,
        X=W,
        W=W,
        candidates=candidates,
        dof=len(y),
        projected=lambda values: values,
        most_effects=most_effects,
        beam=(BEAM,) * (most_effects - 1),
        split="a period at a time",
        folds=lambda W: (held_out(np.eye(len(y)), y, W, period == name, period) for name in PERIODS),
    )
    return model, sigma


def _padded(group: Group, before: int = 0, after: int = 0) -> Group:
    """A candidate that does nothing to the observations before and after its own."""
    return replace(group, columns=[np.pad(part, ((before, after), (0, 0))) for part in group.columns])


def _group(one: Tried, windows: Windows, base: Array, sigma: Array, further: Array) -> Group:
    rows = windows[one.setting] if one.setting else with_walk(windows[NOMINAL], one)
    change = np.concatenate([(_array(simulated(rows)) - base) / sigma, further])[:, None]
    if one.switch:
        return Group(
            one.effect, one.axis, True, [change], [{}], np.ones(1), one.limits, one.unit,
            read=lambda _: (one.size, {}), shifted=True, scales=np.ones(1),
        )  # fmt: skip
    # An effect's amplitude is its size, or the square of it.
    unit = one.size**2 if one.squared else one.size
    low, high = (limit**2 if one.squared else limit for limit in one.limits)
    return Group(
        one.effect, one.axis, True, [change / unit], [{}], np.ones(1), (low, high), one.unit, positive=True,
        read=_root if one.squared else _plain, size_sigma=lambda size: 0.0,
    )  # fmt: skip


def _root(amplitudes: Array) -> tuple[float, Parameters]:
    return float(np.sqrt(max(amplitudes[0], 0.0))), {}


def _plain(amplitudes: Array) -> tuple[float, Parameters]:
    return float(amplitudes[0]), {}


def with_walk(rows: pd.DataFrame, one: Tried, entropy: int = 1998) -> pd.DataFrame:
    """The nominal's windows with a walk of the gyro's bias: what the batch finds moves with the bias, nothing else does."""
    config = applied(MissionConfig(), [parse(f"{one.effect}:{one.axis}={one.size}")])
    column = f"bias_{one.axis}_deg_h"
    bias = [walked(config, day, entropy)["xyz".index(str(one.axis))] * DEG_H for day in rows["day"]]
    return rows.assign(**{column: rows[column] + bias})


def _rivals() -> Iterator[Group]:
    """Random differences, in sigmas."""
    each = np.eye(len(NUMBERS))
    places: list[tuple[str, str | None, Array]] = [("unknown in all numbers", None, each)]
    places += [
        ("unknown in a period", period, each[:, [k for k, number in enumerate(NUMBERS) if number[2] == period]])
        for period in PERIODS
    ]
    places += [("unknown in a number", named(number), each[:, [k]]) for k, number in enumerate(NUMBERS)]
    for effect, axis, columns in places:
        yield Group(effect, axis, False, [columns], [{}], np.ones(1), UNKNOWN_LIMITS, "sigma", process=True)


def named(number: Number) -> str:
    """A number of R Table 3 in words."""
    parameter, axis, period = number
    what = {"attitude_accuracy_deg": axis, "yaw_update_deg": "update", "gyro_bias_std_deg_h": f"b_{axis}"}[parameter]
    return f"{what} {period}"


def _array(values: Mapping[Number, float]) -> Array:
    return np.array([values[number] for number in NUMBERS])


def tables(found: Diagnosis) -> dict[str, pd.DataFrame]:
    """Probabilities of the candidates, sizes of the likeliest explanation, and what it leaves number by number."""
    return {
        "diagnosis": pd.DataFrame(
            [{"cause": label, "probability": p} for label, p in found.probabilities.items() if p >= DEFAULT.group_share]
        ),
        "diagnosis_sizes": pd.DataFrame(
            [{"cause": one.label, "size": one.size, "sigma": size_sigma(one), "unit": one.unit} for one in found.fitted]
        ),
        "diagnosis_left": pd.DataFrame(
            [{"number": named(number), "left_sigmas": float(x)} for number, x in zip(NUMBERS, found.left, strict=True)]
        ),
    }


def size_sigma(one: Fitted) -> float:
    """Sigma of a size, of an amplitude a that is the size's square σ_a/(2 √a)."""
    squared = any(trial.squared and trial.effect == one.effect and not trial.switch for trial in TRIALS)
    return float(one.sigmas[0] / (2 * one.size)) if squared and one.size > 0 else one.sigma


def verdict(found: Diagnosis) -> str:
    """What is named, or that something unknown is at work, with the probability of that."""
    sure = [label for label, p in found.probabilities.items() if p >= DEFAULT.named and not label.startswith(UNKNOWN)]
    unknown = found.attribution.unknown
    return f"{' + '.join(sure) or 'nothing'} named; unknown beside it with probability {unknown:.2f}"

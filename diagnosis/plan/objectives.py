"""What a search of slews makes smallest: the worst sigma of G and b, or the size that separates two effects.

Intervals that share no reference have independent residuals, so that their information adds. For the sigmas it is that of
G and b, as the calibrator states it: a noise-free recording of each interval is simulated, and its whitened sensitivity H
taken at the true parameters (`gyrocal.calibration.problem`),

    P⁻¹ = D⁻² + Σ_k H_kᵀ H_k,    v_j = ln(σ_j/σ_j0)

with the plausible ranges D as a weak prior, which only keeps P finite, and σ_0 of the plan to improve on.

For two effects A and B it is that of G, b and the sizes of both, with the columns of the linear model of the diagnosis. Its
Schur complement S_ab of axis a of A, with G, b and axis b of B estimated beside it, is the squared length that the
signature of A per unit keeps. A size of √(2 ln 19/S_ab) separates the two (`diagnosis.plan.separability`), so that

    v_ab = −½ ln(S_ab/2 ln 19)

The columns of an interval are taken in a recording of the scenario's first interval and this one: an effect may count its
time from the start.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.groups import list_effect_groups
from diagnosis.plan.columns import linearise_noise_free
from diagnosis.plan.separate import check_shapes
from diagnosis.plan.settings import SETTINGS
from diagnosis.plan.slew_design import IntervalDesign, SlewLimits, build_interval, build_slews, compute_sun_margin
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.errors import InputError
from simulator.effects import EFFECTS
from simulator.scenario import Scenario
from simulator.simulate import simulate

Array = NDArray[np.float64]

TURN_PER_SAMPLE = np.deg2rad(5.0)


@dataclass(frozen=True)
class Measured:
    """One design of one interval.

    Attributes
    ----------
    information : (n, n) Hᵀ H of parameters divided by their plausible ranges, and of sizes
    slew_s : time of its slews and of the transitions of its hold
    spare_s : time left over; negative if the slews do not fit
    sun_margin : beyond the keep-out angle, rad
    """

    information: Array
    slew_s: float
    spare_s: float
    sun_margin: float

    @property
    def is_allowed(self) -> bool:
        """Whether the design fits in the interval and keeps out the Sun."""
        return self.spare_s >= 0 and self.sun_margin >= 0


class PlanObjective(ABC):
    """Values to make small, of the information of designs of each interval, which are measured once each.

    Parameters
    ----------
    scenario : the plan to improve on
    limits : of the slews
    """

    def __init__(self, scenario: Scenario, limits: SlewLimits):
        each = max(1, int(TURN_PER_SAMPLE / limits.rate / scenario.gyro.sample_s))
        coarse = scenario.gyro.model_copy(update={"sample_s": each * scenario.gyro.sample_s})
        self.scenario = scenario.model_copy(update={"gyro": coarse})
        self.limits = limits
        self._measured: dict[tuple[int, IntervalDesign], Measured] = {}

    @abstractmethod
    def compute_information(self, k: int, section: Any) -> Array:
        """Information (n, n) of interval k as a section of a scenario."""

    @abstractmethod
    def compute_total_values(self, information: Array) -> Array:
        """Values (..., m) of the summed information (..., n, n) of all intervals; the largest counts."""

    @cached_property
    def own_information(self) -> Array:
        """(n, n) of the plan to improve on."""
        return np.sum([self.compute_information(k, one) for k, one in enumerate(self.scenario.interval)], axis=0)

    def measure(self, k: int, design: IntervalDesign) -> Measured:
        """Measure a design of interval k."""
        found = self._measured.get((k, design))
        if found is None:
            section = self.scenario.interval[k]
            made = build_interval(section, design, self.limits)
            profile = made.build_profile(self.scenario.orbit.build_circular_orbit())
            _, spare = build_slews(design, section.stop_s - section.start_s, self.limits)
            keep_out = self.limits.keep_out
            margin = np.pi if keep_out is None else compute_sun_margin(profile, self.scenario.epoch, keep_out)
            slew_s = sum(stop - start for start, stop in profile.moving_spans)
            found = Measured(self.compute_information(k, made), slew_s, 0.0 if design.hold else spare, margin)
            self._measured[k, design] = found
        return found

    def compute_values(self, designs: Sequence[IntervalDesign]) -> Array:
        """Values (m,) of a plan."""
        return self.compute_total_values(np.sum([self.measure(k, one).information for k, one in enumerate(designs)], axis=0))

    def compute_slew_time(self, designs: Sequence[IntervalDesign]) -> float:
        """Time of all slews and of the transitions of holds, s."""
        return sum(self.measure(k, one).slew_s for k, one in enumerate(designs))

    def compute_smooth_worst(self, information: Array) -> Array:
        """(1/p) ln Σ exp(p v) of the values of summed information (..., n, n)."""
        values = self.compute_total_values(information)
        top = values.max(axis=-1, keepdims=True)
        return np.asarray(
            top[..., 0] + np.log(np.exp(SETTINGS.smooth_norm * (values - top)).sum(axis=-1)) / SETTINGS.smooth_norm
        )


class SigmaObjective(PlanObjective):
    """Logarithms of the sigmas of G and b over those of the plan to improve on."""

    def __init__(self, scenario: Scenario, limits: SlewLimits):
        super().__init__(scenario, limits)
        self.truth = GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
        self.plausible = estimate_plausible_ranges(simulate(self.scenario, noise=False)).vector(np.arange(12) >= 9)
        self.baseline = self.compute_sigmas(self.own_information)

    def compute_information(self, k: int, section: Any) -> Array:
        """Hᵀ H (12, 12) of one interval."""
        recording = simulate(self.scenario.model_copy(update={"interval": (section,)}), noise=False)
        problem = Problem.build(recording, prepare_measurements(recording))
        H = problem.state(self.truth).H / problem.scale * self.plausible
        return np.asarray(H.T @ H)

    def compute_sigmas(self, information: Array) -> Array:
        """Sigmas (..., 12) over plausible ranges, of the summed information of all intervals (..., 12, 12)."""
        P = np.linalg.inv(information + np.eye(12))
        return np.asarray(np.sqrt(np.diagonal(P, axis1=-2, axis2=-1)))

    def compute_total_values(self, information: Array) -> Array:
        """ln(σ/σ_0), (..., 12)."""
        return np.asarray(np.log(self.compute_sigmas(information) / self.baseline))


class SeparationObjective(PlanObjective):
    """Logarithms of the sizes of one effect that separate it from another, for each pair of axes.

    Parameters
    ----------
    scenario, limits : as for all objectives
    effect, other : names of two effects; of an effect with several options the first one counts

    Raises
    ------
    InputError
        The scenario cannot show an effect, an effect is random or has a time or a period that is searched, or the
        information of the intervals does not add to that of the recording: a temperature has another mean in each.
    """

    def __init__(self, scenario: Scenario, limits: SlewLimits, effect: str, other: str):
        super().__init__(scenario, limits)
        check_shapes(effect, other)
        for name in (effect, other):
            if EFFECTS[name].switched or EFFECTS[name].scanned:
                raise InputError(
                    f"{name}: a diagnosis searches its time or its period, and slews are searched for effects of one shape; "
                    "leave --optimise out to list extra maneuvers"
                )
        self.effect, self.other = effect, other
        self.parts: dict[str, list[slice]] = {}
        whole = self._measure_sections(self.scenario.interval, range(len(self.scenario.interval)))
        added = self.own_information
        norms = np.sqrt(np.diag(whole))
        if whole.shape != added.shape or (np.abs(whole - added) > SETTINGS.additive * np.outer(norms, norms)).any():
            raise InputError(
                f"{effect},{other}: what they show in one interval depends on the others, and slews are searched interval by "
                "interval; leave --optimise out to list extra maneuvers"
            )

    def compute_information(self, k: int, section: Any) -> Array:
        """Information (n, n) of G, b and the sizes about all axes, beside the start attitude."""
        return self._measure_sections((self.scenario.interval[0], section) if k else (section,), [int(k > 0)])

    def _measure_sections(self, sections: Sequence[Any], shown: Sequence[int]) -> Array:
        """Information of some intervals of a recording of several."""
        model = linearise_noise_free(self.scenario.model_copy(update={"interval": sections}))
        columns, at = [model.calibration * PLAUSIBLE_RANGE], 0
        parts: dict[str, list[slice]] = {self.effect: [], self.other: []}
        for group in list_effect_groups(model, [EFFECTS[self.effect], EFFECTS[self.other]], None):
            columns.append(group.columns[0])
            parts[group.effect].append(slice(at, at + group.columns[0].shape[1]))
            at += group.columns[0].shape[1]
        for name, found in parts.items():
            if not found:
                raise InputError(f"{name}: the scenario cannot show it; gyrocal plan tells why")
        self.parts = parts
        own = np.concatenate([np.arange(one.rows.start, one.rows.stop) for one in model.blocks if one.interval in shown])
        H, start = np.hstack(columns)[own], scipy.linalg.orth(model.attitude_nuisance[own])
        H = H - start @ (start.T @ H)
        return np.asarray(H.T @ H)

    def compute_total_values(self, information: Array) -> Array:
        """Logarithms of the sizes (..., m), for each axis of the first effect beside each axis of the other."""
        N, C = information[..., :12, :12] + SETTINGS.weak_prior * np.eye(12), information[..., :12, 12:]
        left = information[..., 12:, 12:] - np.swapaxes(C, -1, -2) @ np.linalg.solve(N, C)
        out = []
        for first, second in product(self.parts[self.effect], self.parts[self.other]):
            both, beside = left[..., first, second], left[..., second, second]
            floor = (
                SETTINGS.weak_prior * np.trace(beside, axis1=-2, axis2=-1)[..., None, None] * np.eye(beside.shape[-1])
                + SETTINGS.no_length
            )
            kept = left[..., first, first] - both @ np.linalg.solve(beside + floor, np.swapaxes(both, -1, -2))
            squared = np.trace(kept, axis1=-2, axis2=-1) / kept.shape[-1]
            out.append(0.5 * np.log(2 * SETTINGS.log_odds / np.maximum(squared, SETTINGS.no_length)))
        return np.stack(out, axis=-1)

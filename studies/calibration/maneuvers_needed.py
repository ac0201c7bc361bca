"""Which maneuvers are needed: the parameters that each subset of the calibration intervals determines.

The study is a grid without random numbers, a case a subset of the scenario's intervals with references at their ends only, or
as a series. Residuals and their covariance are those of `calibrate`, at the true parameters. A subset determines a combination
of parameters if the data know it better than its plausible range, see `gyrocal.calibration.observability`: 0.01 in G, 10 deg/h
in b. An interval with references at its ends has three equations, so R's four intervals with independent rates are the least
that could do for twelve parameters; whether they do depends on their rates.

The sigmas are those of the data together with the plausible range as a prior, P = (Σ⁻¹ + W)⁻¹: finite for every subset, and
where the data determine everything larger than their own by at most the factor (1 + 1/s²)^½, s the smallest singular value.
The information of a subset is ½ Σ log₂(1 + s²), in bits: the number of halvings of the plausible volume.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import combinations, product
from typing import ClassVar

import numpy as np
import pandas as pd
from pydantic import Field

from gyrocal import NAMES, GyroParameters
from gyrocal.calibration.observability import PLAUSIBLE_RANGE, evaluate_observability
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.recording import Recording, find_reference_rows
from simulator.scenario import override
from studies.calibration.shared_truth import NoiseFreeSimulation, build_once, get_true_parameters
from studies.montecarlo.study import GridConfig, Streams, Study, load_base_scenario
from studies.report import panels
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.report.units import PPM_DEG_H, name_columns

REFERENCE_PLACEMENTS = ("ends", "series")
MOST_INTERVALS = 10
SIGMAS = name_columns("sigma")


class ManeuversNeededConfig(GridConfig):
    """What the study runs."""

    axes: ClassVar = ("scenario",)
    series_s: float = Field(default=60.0, gt=0)  # time between the references of a series

    def points(self) -> list[tuple[str, tuple[int, ...]]]:
        """List the reference placements and subsets of the scenario's intervals."""
        intervals = len(load_base_scenario(self).interval)
        if intervals > MOST_INTERVALS:
            raise ValueError(f"scenario: has {intervals} intervals; all subsets of more than {MOST_INTERVALS} are too many")
        subsets = [subset for size in range(1, intervals + 1) for subset in combinations(range(intervals), size)]
        return list(product(REFERENCE_PLACEMENTS, subsets))


@build_once
def _simulate_all_intervals(
    config: ManeuversNeededConfig, simulation: NoiseFreeSimulation
) -> tuple[dict[str, Recording], GyroParameters]:
    """Simulate noise-free recordings of all intervals, by reference placement, and return the true parameters as well."""
    recordings = {}
    for kind in REFERENCE_PLACEMENTS:
        spacing = {"reference.every_s": config.series_s} if kind == "series" else {}
        scenario = override(simulation.scenario, {"reference.at": kind, **spacing})
        recordings[kind] = NoiseFreeSimulation.simulate(scenario).plain
    return recordings, get_true_parameters(simulation.scenario)


def select_intervals(recording: Recording, indices: Collection[int]) -> Recording:
    """Return the recording with some of its intervals and their references."""
    intervals = tuple(recording.intervals[k] for k in indices)
    rows = np.unique(np.concatenate([find_reference_rows(recording.attitudes.t_s, interval) for interval in intervals]))
    return replace(recording, attitudes=recording.attitudes.select_rows(rows), intervals=intervals)


def run_case(config: ManeuversNeededConfig, case: int, streams: Streams) -> dict[str, object]:
    """Compute the parameters that a subset of the maneuvers determines."""
    references, subset = config.points()[case]
    recordings, truth = _simulate_all_intervals(config, case)
    recording = select_intervals(recordings[references], subset)
    state = Problem.build(recording, prepare_measurements(recording)).state(truth)
    # H has the plausible range as its unit already.
    observability = evaluate_observability(state.H / PLAUSIBLE_RANGE, PLAUSIBLE_RANGE, NAMES)
    sigma = np.sqrt(np.diag(np.linalg.inv(state.H.T @ state.H + np.eye(12)))) * PLAUSIBLE_RANGE * PPM_DEG_H
    row: dict[str, object] = {
        "references": references,
        "maneuvers": "+".join(recording.intervals[k].name for k in range(len(subset))),
        "size": len(subset),
        "equations": 3 * len(state.theta),
        "lost": len(observability.unobservable),
        "combinations": "; ".join(observability.unobservable),
        # None rather than infinite, which Parquet readers show in their own ways.
        "condition": observability.condition if observability.condition < 1e15 else None,
        "weakest": float(observability.singular_values[-1]),
        "information_bits": float(0.5 * np.log2(1 + observability.singular_values**2).sum()),
    }
    return row | dict(zip(SIGMAS, sigma.tolist(), strict=True))


STUDY = Study("studies.calibration.maneuvers_needed:STUDY", ManeuversNeededConfig, run_case)


def _parse_maneuver_sets(rows: pd.DataFrame) -> list[frozenset[str]]:
    """Return the set of maneuvers of each row."""
    return [frozenset(text.split("+")) for text in rows["maneuvers"]]


def find_minimal_subsets(rows: pd.DataFrame) -> pd.DataFrame:
    """Find the subsets that determine all twelve while no smaller part of them does; the best conditioned first."""
    sufficient = rows[rows["lost"] == 0]
    sets = _parse_maneuver_sets(sufficient)
    is_minimal = [not any(smaller < subset for smaller in sets) for subset in sets]
    return sufficient[is_minimal].sort_values(["size", "condition"])


def compute_leave_one_out(config: ManeuversNeededConfig, rows: pd.DataFrame) -> pd.DataFrame:
    """Compute the factor by which each sigma grows without a maneuver, a row each, for one reference placement."""
    intervals = load_base_scenario(config).interval
    by_set = dict(zip(_parse_maneuver_sets(rows), rows.to_dict("records"), strict=True))
    everything = frozenset(interval.name for interval in intervals)
    full, growths = by_set[everything], {}
    for interval in intervals:
        reduced = by_set.get(everything - {interval.name})
        if reduced is not None:  # else a scenario of a single interval
            growths[f"{interval.name}: {interval.activity}"] = [reduced[name] / full[name] for name in SIGMAS]
    return pd.DataFrame.from_dict(growths, orient="index", columns=list(NAMES))


def find_blocking_sets(rows: pd.DataFrame) -> pd.DataFrame:
    """Find the smallest sets of maneuvers without which the others, together, leave something undetermined.

    No row's set contains another's. There is no row if even each alone determines everything.
    """
    everything = frozenset.union(*_parse_maneuver_sets(rows))
    by_set = zip(_parse_maneuver_sets(rows), rows.to_dict("records"), strict=True)
    failing = [(everything - subset, row) for subset, row in by_set if row["lost"]]
    minimal = [(omitted, row) for omitted, row in failing if not any(smaller < omitted for smaller, _ in failing)]
    ordered = sorted(minimal, key=lambda item: (len(item[0]), sorted(item[0])))
    table = [("+".join(sorted(omitted)), row["maneuvers"], row["lost"], row["combinations"]) for omitted, row in ordered]
    return pd.DataFrame(table, columns=["without", "left", "lost", "combinations"])


SMALLEST_SUBSET_NOTE = "Of the smallest subsets that determine all twelve parameters the best conditioned one is named."
LOST = "What the other maneuvers together do not determine, for the smallest sets that may not all be left out."


def _build_checks(rows: pd.DataFrame, references: str) -> list[Check]:
    """Build the checks of one kind of references."""
    placement = f"references at {references}"
    minimal = find_minimal_subsets(rows)
    checks = [Check(f"subsets that determine all twelve, {placement}", int((rows["lost"] == 0).sum()))]
    if len(minimal):
        smallest = minimal[minimal["size"] == minimal["size"].min()]
        best = smallest.iloc[0]
        of_size = int((rows["size"] == best["size"]).sum())
        worst = max(best[name] / limit for name, limit in zip(SIGMAS, PLAUSIBLE_RANGE * PPM_DEG_H, strict=True))
        common = sorted(frozenset.intersection(*_parse_maneuver_sets(minimal)))
        checks += [
            Check(f"maneuvers in the smallest of them, {placement}", int(best["size"])),
            Check(f"determining subsets of that size, of {of_size}, {placement}", len(smallest)),
            Check(f"best conditioned of these, {placement}", best["maneuvers"], meaning=SMALLEST_SUBSET_NOTE),
            Check(f"its worst sigma by the plausible range, {placement}", worst),
            Check(f"in every determining subset, {placement}", ", ".join(common) or "none"),
        ]
    blocking = find_blocking_sets(rows)
    set_sizes = blocking["without"].str.count("\\+")
    for line in blocking[set_sizes == set_sizes.min()].to_dict("records"):
        checks.append(Check(f"lost without {line['without']}, {placement}", line["combinations"], meaning=LOST))
    return checks


def report(config: ManeuversNeededConfig, rows: pd.DataFrame) -> Report:
    """Report the smallest determining subsets, indispensable maneuvers, and the growth of sigmas without each."""
    kinds = {references: rows[rows["references"] == references] for references in REFERENCE_PLACEMENTS}
    columns = ["references", "maneuvers", "size", "condition", "weakest", "information_bits", *SIGMAS]
    minimal = pd.concat([find_minimal_subsets(kind_rows)[columns] for kind_rows in kinds.values()])
    checks = [check for kind, kind_rows in kinds.items() for check in _build_checks(kind_rows, kind)]
    tables = {"minimal": Table("Smallest determining subsets", minimal)}
    return Report(tables, {"left_out": _draw_growth_figure(config, kinds)}, tuple(checks))


def _draw_growth_figure(config: ManeuversNeededConfig, kinds: Mapping[str, pd.DataFrame]) -> panels.Draw:
    """Draw the growth of each sigma when one maneuver is left out."""
    heat_maps = []
    for kind, rows in kinds.items():
        grid = compute_leave_one_out(config, rows)[::-1]
        heat_maps.append(panels.make_heat_map(grid, "{:.3g}", log=True, title=f"references: {kind}"))
    title = "factor by which a sigma grows when one maneuver is left out"
    return panels.build_sheet(*heat_maps, size=(10.0, 3.6), title=title, sharey=True)


ENTRY = Entry(STUDY, "which maneuvers are needed for which parameters", report)

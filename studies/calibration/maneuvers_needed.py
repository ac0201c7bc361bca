"""Which maneuvers are needed: what every subset of the calibration intervals determines.

The study is a grid without random numbers, a case a subset of the scenario's intervals with references at their ends only, or
as a series. Residuals and their covariance are those of `calibrate`, at the true parameters. A subset determines a combination
of parameters if the data know it better than its plausible range, see `gyrocal.calibration.observability`: 0.01 in G, 10 deg/h
in b. An interval with references at its ends has three equations, so R's four intervals with independent rates are the least
that could do for twelve parameters; whether they do depends on their rates.

The sigmas are those of the data together with the plausible range as a prior, P = (Σ⁻¹ + W)⁻¹: finite for every subset, and
where the data determine everything larger than their own by at most the factor (1 + 1/s²)^½, s the smallest singular value.
What a subset tells altogether is its information ½ Σ log₂(1 + s²), in bits: by how many halvings it shrinks the plausible
volume. It can be shared out among the maneuvers by Shapley's value, the mean over all orders of flying them of what each adds.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations, product
from math import comb
from pathlib import Path
from typing import ClassVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field

from gyrocal import NAMES, GyroParameters
from gyrocal.calibration.observability import PLAUSIBLE_RANGE, observability
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import measurements
from gyrocal.recording import Recording
from simulator.scenario import override
from simulator.simulate import motion, observe
from studies.montecarlo.study import GridConfig, Streams, Study, base_scenario
from studies.report import panels
from studies.report.entry import Entry, Report
from studies.report.tables import Table

Array = NDArray[np.float64]

REFERENCES = ("ends", "series")
MOST_INTERVALS = 10
SHOWN = np.array([1e6] * 9 + [np.rad2deg(1.0) * 3600] * 3)  # ppm, deg/h
SIGMAS = [f"sigma_{name}_{unit}" for name, unit in zip(NAMES, ["ppm"] * 9 + ["deg_h"] * 3, strict=True)]


class ManeuversNeededConfig(GridConfig):
    """What the study runs.

    Attributes
    ----------
    series_s : time between the references of a series
    """

    axes: ClassVar = ("scenario",)
    series_s: float = Field(default=60.0, gt=0)

    def points(self) -> list[tuple[str, tuple[int, ...]]]:
        """Kind of references and subset of the scenario's intervals."""
        intervals = len(base_scenario(self).interval)
        if intervals > MOST_INTERVALS:
            raise ValueError(f"scenario: has {intervals} intervals; all subsets of more than {MOST_INTERVALS} are too many")
        return list(product(REFERENCES, subsets(intervals)))


def subsets(intervals: int) -> list[tuple[int, ...]]:
    """All but the empty one, the smallest first."""
    return [chosen for size in range(1, intervals + 1) for chosen in combinations(range(intervals), size)]


@lru_cache(maxsize=4)
def _whole(text: str, references: str) -> tuple[Recording, GyroParameters]:
    """Noise-free recording with all intervals, and its true parameters; made once a process."""
    config = ManeuversNeededConfig.model_validate_json(text)
    changes: dict[str, str | float] = {"reference.at": references}
    scenario = override(
        base_scenario(config), changes | ({"reference.every_s": config.series_s} if references == "series" else {})
    )
    plain = observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None)
    return plain, GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def part(recording: Recording, chosen: Collection[int]) -> Recording:
    """The recording with some of its intervals and their references."""
    intervals = tuple(recording.intervals[k] for k in chosen)
    seen = recording.attitudes
    inside = np.any([(seen.t_s >= i.start_s - 1e-6) & (seen.t_s <= i.stop_s + 1e-6) for i in intervals], axis=0)
    kept = replace(seen, t_s=seen.t_s[inside], quaternions=seen.quaternions[inside], sigma=seen.sigma[inside])
    return replace(recording, attitudes=kept, intervals=intervals)


def case(config: ManeuversNeededConfig, case: int, streams: Streams) -> dict[str, object]:
    """What a subset determines."""
    references, chosen = config.points()[case]
    whole, truth = _whole(config.model_dump_json(), references)
    recording = part(whole, chosen)
    state = Problem.of(recording, measurements(recording)).state(truth)
    # H has the plausible range as its unit already.
    judged = observability(state.H / PLAUSIBLE_RANGE, PLAUSIBLE_RANGE, NAMES)
    sigma = np.sqrt(np.diag(np.linalg.inv(state.H.T @ state.H + np.eye(12)))) * PLAUSIBLE_RANGE * SHOWN
    row: dict[str, object] = {
        "references": references,
        "maneuvers": "+".join(recording.intervals[k].name for k in range(len(chosen))),
        "size": len(chosen),
        "equations": 3 * len(state.theta),
        "lost": len(judged.unobservable),
        "combinations": "; ".join(judged.unobservable),
        # None rather than infinite, which Parquet readers show in their own ways.
        "condition": judged.condition if judged.condition < 1e15 else None,
        "weakest": float(judged.singular_values[-1]),
        "information_bits": float(0.5 * np.log2(1 + judged.singular_values**2).sum()),
    }
    return row | dict(zip(SIGMAS, sigma.tolist(), strict=True))


def _members(rows: pd.DataFrame) -> list[frozenset[str]]:
    return [frozenset(text.split("+")) for text in rows["maneuvers"]]


def minimal(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of the subsets that determine all twelve while no smaller part of them does; the best conditioned first."""
    sufficient = rows[rows["lost"] == 0]
    sets = _members(sufficient)
    kept = [not any(other < own for other in sets) for own in sets]
    return sufficient[kept].sort_values(["size", "condition"])


def without_one(config: ManeuversNeededConfig, rows: pd.DataFrame) -> pd.DataFrame:
    """What each maneuver adds, a row each, from the rows of one kind of references.

    Returns
    -------
    maneuver, activity; lost, combinations: not determined without it; bits_added to all others, shapley_bits; most_helped: the
    parameter whose sigma grows most without it, by growth; growth_<parameter>: every such factor.
    """
    intervals = base_scenario(config).interval
    by_set = dict(zip(_members(rows), rows.to_dict("records"), strict=True))
    everything = frozenset(i.name for i in intervals)
    full = by_set[everything]
    shares = shapley({own: row["information_bits"] for own, row in by_set.items()}, everything)
    out = []
    for interval in intervals:
        rest = by_set.get(everything - {interval.name})
        if rest is None:  # a scenario of a single interval
            continue
        growth = np.array([rest[name] / full[name] for name in SIGMAS])
        line = {"maneuver": interval.name, "activity": interval.activity, "lost": rest["lost"]}
        line |= {"combinations": rest["combinations"], "bits_added": full["information_bits"] - rest["information_bits"]}
        line |= {"shapley_bits": shares[interval.name], "most_helped": NAMES[int(growth.argmax())], "by": growth.max()}
        out.append(line | {f"growth_{name}": value for name, value in zip(NAMES, growth, strict=True)})
    return pd.DataFrame(out)


def shapley(information: dict[frozenset[str], float], everything: Iterable[str]) -> dict[str, float]:
    """Each member's mean addition over all orders; information by subset, that of the empty one zero."""
    members = sorted(everything)
    n = len(members)
    out = dict.fromkeys(members, 0.0)
    for name in members:
        for own, value in information.items():
            if name in own:
                before = information.get(own - {name}, 0.0)
                out[name] += (value - before) / (n * comb(n - 1, len(own) - 1))
    return out


def blocking(rows: pd.DataFrame) -> pd.DataFrame:
    """The smallest sets of maneuvers without which the others, together, leave something undetermined.

    Returns
    -------
    without, left, lost, combinations; no row's set contains another's, and none if even each alone determines everything.
    """
    whole = frozenset.union(*_members(rows))
    failing = [(whole - own, row) for own, row in zip(_members(rows), rows.to_dict("records"), strict=True) if row["lost"]]
    least = [(gone, row) for gone, row in failing if not any(other < gone for other, _ in failing)]
    table = [
        {"without": "+".join(sorted(gone)), "left": row["maneuvers"], "lost": row["lost"], "combinations": row["combinations"]}
        for gone, row in sorted(least, key=lambda item: (len(item[0]), sorted(item[0])))
    ]
    return pd.DataFrame(table, columns=["without", "left", "lost", "combinations"])


def by_size(rows: pd.DataFrame) -> pd.DataFrame:
    """Subsets by references and size: how many determine everything, and the fewest combinations lost."""
    grouped = rows.groupby(["references", "size"])
    return grouped.agg(
        subsets=("lost", "size"),
        determine_all=("lost", lambda lost: int((lost == 0).sum())),
        fewest_lost=("lost", "min"),
        most_lost=("lost", "max"),
        best_condition=("condition", "min"),
        most_bits=("information_bits", "max"),
    ).reset_index()


def _smallest_findings(rows: pd.DataFrame, references: str) -> list[str]:
    least = minimal(rows)
    if least.empty:
        return [f"References at {references}: no subset determines all twelve parameters."]
    smallest = least[least["size"] == least["size"].min()]
    same = int((rows["size"] == smallest["size"].iloc[0]).sum())
    best = smallest.iloc[0]
    worst = max(best[name] / limit for name, limit in zip(SIGMAS, PLAUSIBLE_RANGE * SHOWN, strict=True))
    common = sorted(frozenset.intersection(*_members(least)))
    listed = ", ".join(smallest["maneuvers"].head(4)) + (", …" if len(smallest) > 4 else "")
    return [
        f"References at {references}: the smallest subsets that determine all twelve have {best['size']} "
        f"maneuver{'s' if best['size'] > 1 else ''}, {len(smallest)} of the {same} of that size: {listed}; "
        f"the best conditioned is {best['maneuvers']} "
        f"(condition {best['condition']:.0f}, worst sigma {worst:.1%} of the plausible range).",
        f"References at {references}: every determining subset contains {', '.join(common)}."
        if common
        else f"References at {references}: no maneuver is in every determining subset.",
    ]


def report(config: ManeuversNeededConfig, rows: pd.DataFrame) -> Report:
    """Smallest determining subsets, indispensable maneuvers, and what each adds."""
    findings: list[str] = []
    tables = {"by_size": Table("Subsets by size", by_size(rows))}
    added = {}
    for references in REFERENCES:
        chosen = rows[rows["references"] == references]
        findings += _smallest_findings(chosen, references)
        added[references] = table = without_one(config, chosen)
        needed = blocking(chosen)
        for line in needed.to_dict("records"):
            if line["without"].count("+") == needed["without"].str.count("\\+").min():
                findings.append(
                    f"References at {references}: without {line['without']} together is lost: {line['combinations']}."
                )
        if len(table):
            most = table.sort_values("shapley_bits").iloc[-1]
            total = table["shapley_bits"].sum()
            findings.append(
                f"References at {references}: {most['maneuver']} ({most['activity']}) tells most, {most['shapley_bits']:.1f} "
                f"of {total:.1f} bits; left out, sigmas grow most by: "
                + ", ".join(f"{x['maneuver']} {x['most_helped']} ×{x['by']:.1f}" for x in table.to_dict("records"))
                + "."
            )
        columns = ["maneuvers", "size", "condition", "weakest", "information_bits", *SIGMAS]
        tables[f"minimal_{references}"] = Table(
            f"Smallest determining subsets, references at {references}", minimal(chosen)[columns]
        )
        tables[f"needed_{references}"] = Table(
            f"Maneuvers of which at least one must be flown, references at {references}", needed
        )
        kept = [name for name in table if not str(name).startswith("growth")]
        tables[f"added_{references}"] = Table(f"What each maneuver adds, references at {references}", table[kept])
    everything = ["references", "maneuvers", "lost", "condition", "combinations"]
    tables["subsets"] = Table("Every subset: combinations not determined", rows[everything])
    return Report(
        tables,
        {"left_out": partial(_figure, added), "lost_by_size": partial(_size_figure, rows)},
        findings=tuple(findings),
    )


def _figure(added: dict[str, pd.DataFrame], path: Path) -> Path:
    """Growth of each sigma when one maneuver is left out."""
    with mpl.rc_context(panels.STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        for axes, (references, table) in zip(figure.subplots(1, 2, sharey=True), added.items(), strict=True):
            values = table[[f"growth_{name}" for name in NAMES]].to_numpy()
            image = axes.imshow(np.log10(values), cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
            for (i, j), value in np.ndenumerate(values):
                if value >= 1.05:
                    text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
                    axes.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if value > 4 else "black")
            axes.set_xticks(range(12), NAMES, rotation=60, fontsize=8)
            axes.set_yticks(range(len(table)), [f"{a}: {b}" for a, b in zip(table["maneuver"], table["activity"], strict=True)])
            axes.set_title(f"references: {references}", loc="left", fontsize=9)
        bar = figure.colorbar(image, ax=figure.axes, shrink=0.8, ticks=[0, 0.5, 1.0])
        bar.set_ticklabels(["1", "3", "10"])
        figure.suptitle("factor by which a sigma grows when one maneuver is left out (blank: below 1.05)", fontsize=9)
        return panels.save(figure, path)


def _size_figure(rows: pd.DataFrame, path: Path) -> Path:
    """Combinations lost, by size of the subset; area by the number of subsets."""
    with mpl.rc_context(panels.STYLE):
        figure = Figure(figsize=(6.4, 3.0), layout="constrained")
        for axes, references in zip(figure.subplots(1, 2, sharey=True), REFERENCES, strict=True):
            counts = rows[rows["references"] == references].groupby(["size", "lost"]).size()
            size, lost = (counts.index.get_level_values(level) for level in (0, 1))
            axes.scatter(size, lost, s=14 * counts + 30, color=np.where(lost == 0, "#00798c", "#d1495b"), zorder=3)
            for x, y, count in zip(size, lost, counts, strict=True):
                axes.text(x, y, str(count), ha="center", va="center", fontsize=7, color="white", zorder=4)
            axes.set_title(f"references: {references}", loc="left", fontsize=9)
            axes.set_xlabel("maneuvers in the subset")
            axes.set_xticks(sorted(set(size)))
        figure.axes[0].set_ylabel("combinations not determined")
        return panels.save(figure, path)


STUDY = Study("studies.calibration.maneuvers_needed:STUDY", ManeuversNeededConfig, case)
ENTRY = Entry(STUDY, "which maneuvers are needed for which parameters", report)

"""Are the percentiles and the interval that ``gyrocal compare`` states what they say?

Each *pair* is a recording of TRMM's plan with a drawn effect, and the scenario that its diagnosis writes. The effect that is
there is the only one that the diagnosis may name; a draw that it does not name, or
that cannot be calibrated at all, is drawn again, and counted. If the adopted scenario is right, the percentiles of the
recording are uniform over the pairs. The true shrinkage is that of new recordings of the true effect, measured under the
adopted scenario, and the stated interval must cover it.

*Controls* are recordings of M0 on plans of slow and fast sampling, against M0 on the replayed motion: what the smoothing
of the motion does to statistics would show there, and the interval of the gap must hold zero.

One statistic stands for each kind, named before the first run; statistics of one recording are correlated, so that more of them
would be the same test again.
"""

from typing import Annotated, Any, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from diagnosis.adopt import adopted
from diagnosis.diagnose import diagnose
from gyrocal import InputError, calibrate
from gyrocal.recording import Recording
from simulator.adopted import Adopted, Replayed
from studies.compare.bench import Bench
from studies.compare.compare import Comparison, compare
from studies.compare.measure import Ruler
from studies.montecarlo.statistics import binomial_interval
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.report.checks import Check, at_least
from studies.report.entry import Entry, Report
from studies.report.panels import Panel, sheet
from studies.report.tables import Table
from studies.validation.world.cases import Drawn, draw
from studies.validation.world.world import Spec

SUMMARY = "Whether the percentiles and the interval of 'gyrocal compare' hold, on pairs of recording and adopted scenario"
TRIES = 40  # draws of a pair
PERCENTILES = (  # one of each kind, named before the first run
    "mean square of the calibration",
    "rms all x",
    "residual rate lag-1 correlation y",
    "residual rate Allan deviation at 1 reference z",
    "residual rate spectrum, lowest third x",
    "samples lag-1 correlation z",
    "samples spectrum, highest octave y",
)
SMALLEST_P = 0.01
COVERED = (0.83, 0.96)
CONTROLS = ("slews_and_rests", "hand_motion")  # slow and fast sampling


class CompareConfig(StudyConfig):
    """What is drawn.

    Attributes
    ----------
    cases : pairs, and the controls after them
    controls : of each plan of theirs
    flights : of each scenario, and of the truth
    snr : range of the effects' signal-to-noise ratio in the attitude
    """

    cases: int = 70
    controls: int = 10
    flights: int = 60
    snr: Annotated[tuple[float, float], Field(strict=False)] = (8.0, 40.0)

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.dispersions or self.overrides:
            raise ValueError("plans are drawn by the study itself; overrides and dispersions have no effect")
        if self.cases < 2 * self.controls:
            raise ValueError(f"cases: {self.cases} are fewer than the {2 * self.controls} controls")
        return self

    @property
    def pairs(self) -> int:
        """Cases that are pairs."""
        return self.cases - 2 * self.controls


def case(config: CompareConfig, number: int, streams: Streams) -> dict[str, Any]:
    """A pair or a control."""
    if number >= config.pairs:
        plan = CONTROLS[(number - config.pairs) // config.controls]
        found = compare(_control(plan, config.entropy, number), [], runs=config.flights, seed=config.entropy + number + 1)
        return {"kind": f"M0, {plan}", "effect": "", "tries": 1} | _row(found)
    drawn, recording, scenario, tries = _pair(config, number)
    found = compare(recording, [("adopted", scenario)], runs=config.flights, seed=config.entropy + number + 1)
    return (
        {"kind": "pair", "effect": drawn.settings[0].label(), "tries": tries}
        | _row(found)
        | _truth(config, drawn, recording, scenario, found)
    )


def recording(config: CompareConfig, number: int, streams: Streams) -> Recording:
    """The recording of a case."""
    if number >= config.pairs:
        return _control(CONTROLS[(number - config.pairs) // config.controls], config.entropy, number)
    return _pair(config, number)[1]


def _pair(config: CompareConfig, number: int) -> tuple[Drawn, Recording, Adopted, int]:
    """A recording with an effect, the scenario with it adopted, and how many draws that took."""
    spec = Spec("known", config.entropy, config.snr)
    for tries in range(TRIES):
        try:
            drawn = draw(spec, number * TRIES + tries, "single", "trmm")
        except InputError:  # it reaches no such strength on this plan
            continue
        recorded = drawn.recording()
        if not _calibrated(recorded):
            continue
        found = diagnose(recorded, library=[drawn.settings[0].effect])
        adoption = adopted(found)
        if [one.label() for one in adoption.effects] == [one.label() for one in drawn.settings]:
            plan = Replayed(recorded, found.G, found.bias)
            return drawn, recorded, Adopted("adopted", plan, adoption.effects, adoption.covariance), tries + 1
    raise InputError(f"pair {number}: the diagnosis named none of {TRIES} draws")


def _calibrated(recorded: Recording) -> bool:
    """Whether the calibration can cope with a recording; a gyro that misses most of a slew is beyond any linearisation."""
    try:
        calibrate(recorded)
    except InputError:
        return False
    return True


def _row(found: Comparison) -> dict[str, Any]:
    """Gap and percentiles of the last scenario."""
    standing = found.standings[-1]
    percentile = dict(zip(standing.names, standing.statistics["percentile"], strict=True))
    gap = standing.gap
    row = {
        "before": gap.before,
        "before_low": gap.before_90[0],
        "before_high": gap.before_90[1],
        "after": gap.after,
        "shrinkage": gap.shrinkage,
        "shrinkage_low": gap.shrinkage_90[0],
        "shrinkage_high": gap.shrinkage_90[1],
        "extreme": standing.extreme[0],
        "judged": standing.extreme[1],
    }
    return row | {name: float(percentile.get(name, np.nan)) for name in PERCENTILES}


def _truth(config: CompareConfig, drawn: Drawn, recorded: Recording, scenario: Adopted, found: Comparison) -> dict[str, float]:
    """Shrinkage on new recordings of the same truth, for the sizes that were adopted."""
    plan = scenario.plan
    assert isinstance(plan, Replayed)
    ruler = Ruler.of(recorded, calibrate(recorded).parameters)
    bench = Bench.of(scenario, recorded, ruler, "adopted")
    bare, under = [], []
    for flight in range(config.flights):
        again = drawn.world.recording(drawn.settings, draw=flight + 1)
        bare.append(ruler.misfit(again))
        under.append(ruler.misfit(bench.under(again)))
    floors = [float(standing.statistics["mean"].iloc[0]) for standing in found.standings]
    dof = ruler.degrees_of_freedom
    before = float(np.mean(bare)) - floors[0]
    after = float(np.mean(under)) - floors[1] * dof / (dof - bench.places.size)
    return {"true_before": before, "true_after": after, "true_shrinkage": 1 - after / before}


def _control(plan: str, entropy: int, number: int) -> Recording:
    """Draw a recording of M0 on another craft's plan."""
    return draw(Spec("known", entropy), number, "none", plan).recording()


STUDY = Study("studies.validation.world.compare_check:STUDY", CompareConfig, case, recording)


def report(config: CompareConfig, rows: pd.DataFrame) -> Report:
    """Uniformity of percentiles and coverage of the interval."""
    pairs = rows[rows["kind"] == "pair"]
    checks = [*_uniform(pairs, "pairs"), *_coverage(pairs)]
    for kind, own in rows[rows["kind"] != "pair"].groupby("kind", sort=False):
        checks += _uniform(own, str(kind))
        inside = int(((own["before_low"] <= 0) & (own["before_high"] >= 0)).sum())
        checks.append(Check(f"{kind}: gap's 90 % interval holds zero, {inside} of {len(own)}", inside / len(own)))
    columns = ["effect", "tries", "before", "after", "shrinkage", "shrinkage_low", "shrinkage_high", "true_shrinkage"]
    tables = {"pairs": Table("Pairs", pairs[["case", *columns]], "Gaps in units of what noise as stated leaves.")}
    figures = {"percentiles": _figure(pairs)}
    return Report(tables, figures, tuple(checks))


def _uniform(rows: pd.DataFrame, label: str) -> list[Check]:
    from scipy.stats import kstest  # scipy.stats costs every worker 45 MiB, and no case needs it

    out = []
    for name in PERCENTILES:
        values = rows[name].dropna()
        if len(values) < 5:
            continue
        p = float(kstest(values, "uniform").pvalue)
        meaning = "Percentiles of the recordings among the flights are uniform; p of Kolmogorov and Smirnov, ties half."
        out.append(Check(f"{label}: {name}, p of {len(values)}", p, at_least(SMALLEST_P), "", meaning))
    return out


def _coverage(pairs: pd.DataFrame) -> list[Check]:
    bounded = pairs[np.isfinite(pairs["shrinkage_low"]) & np.isfinite(pairs["shrinkage_high"])]
    covered = (bounded["shrinkage_low"] <= bounded["true_shrinkage"]) & (bounded["true_shrinkage"] <= bounded["shrinkage_high"])
    count = int(covered.sum())
    share = count / len(bounded) if len(bounded) else float("nan")
    low, high = binomial_interval(count, len(bounded)) if len(bounded) else (float("nan"), float("nan"))
    meaning = "The stated 90 % interval of the shrinkage covers that on new recordings of the truth, where bounded."
    return [
        Check(f"pairs: interval of the shrinkage covers, {count} of {len(bounded)}", share, COVERED, "", meaning),
        Check("pairs: lower end of that share's 95 % interval", low),
        Check("pairs: upper end of that share's 95 % interval", high),
        Check("pairs without a gap in the attitude, unbounded interval", float(len(pairs) - len(bounded))),
        Check("pairs: draws that were not named or not calibrated, and drawn again", float(pairs["tries"].sum() - len(pairs))),
    ]


def _figure(pairs: pd.DataFrame) -> Any:
    def draw_on(axes: Any) -> None:
        for name in PERCENTILES:
            values = np.sort(pairs[name].dropna().to_numpy())
            axes.plot(values, (np.arange(values.size) + 0.5) / max(values.size, 1), label=name)
        axes.plot([0, 1], [0, 1], color="0.4", linestyle=":")

    return sheet(
        Panel(draw_on, "Pairs", "percentile of the recording", "share of the pairs", legend="lower right"), size=(6, 5)
    )


ENTRY = Entry(STUDY, SUMMARY, report)

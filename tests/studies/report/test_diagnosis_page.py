"""What a diagnosis says on the terminal and on its page, for one of each verdict."""

import dataclasses
import io
import re

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape
from rich.console import Console

from diagnosis.answer import RemainderSummary
from diagnosis.budget import Step
from diagnosis.result import Details
from simulator.effects.base import STAGE_NAMES
from simulator.effects.sensor import ALL_EFFECTS
from studies.report import (
    diagnosis_answers,
    diagnosis_figures,
    diagnosis_summary,
    gap_budget,
    pointing_cost,
    svg,
)
from studies.report import diagnosis_page as diagnosis_report
from studies.report import diagnosis_words as words
from tests.diagnosis_cases import CASES, regressors, residuals
from tests.pages import checked

EVERYWHERE = {"map", "residuals"}
FIGURES = {
    "none": EVERYWHERE,
    "named": EVERYWHERE | {"cause-bias_orbital-z"},
    "pair": EVERYWHERE | {"cause-bias_orbital-z", "cause-g_matrix_step-z"},
    "group": EVERYWHERE | {"cause-time_offset"},
    "unknown": EVERYWHERE,
    "not identifiable": EVERYWHERE,
    "stream": EVERYWHERE,
}


RENDERED = {"pair", "not identifiable"}  # cases whose figures are rendered; those of the others are drawn only


TITLES = (
    *("Where it departs from the baseline, strongest test first", "Causes", "Other explanations", "How far the gap closes"),
    *("Effect on the calibration", "Limits of this recording"),
)


class Pages(dict):
    """The page of each case, made when it is first asked for: a worker may have few of the tests."""

    def __missing__(self, name):
        with pytest.MonkeyPatch.context() as patch:
            if name not in RENDERED:
                patch.setattr(svg, "render_svg", lambda figure: b'<svg viewBox="0 0 1 1"></svg>')
            self[name] = diagnosis_report.build_diagnosis_page(CASES[name]())
        return self[name]


@pytest.fixture(scope="module")
def pages():
    return Pages()


def summary(diagnosis):
    console = Console(file=io.StringIO(), width=100, emoji=True)
    diagnosis_summary.show(console, diagnosis)
    return console.file.getvalue()


# ---- summary -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_summary_has_its_parts_and_says_nothing_that_is_not_so(case):
    diagnosis = CASES[case]()
    shown = summary(diagnosis)
    assert words.describe_verdict(diagnosis) in " ".join(shown.split())
    titles = [line for line in shown.splitlines() if line in TITLES]
    assert titles == [title for title in TITLES if title in titles]
    assert {*TITLES[3:4], *TITLES[-2:]} <= set(titles)
    assert sum(f"- {cause.label}: " in shown for cause in diagnosis.causes) == len(diagnosis.causes)
    assert ("No gap" in shown) == (case == "none")
    assert ("% of the gap is closed" in shown) == (case in ("named", "pair", "group"))
    assert ("change in sigma" in shown) == (case in ("named", "pair", "group"))
    assert "nan" not in shown.lower().split()
    assert "Limits of this recording" in shown


def test_probabilities_are_never_certain():
    assert words.format_percent(1.0) == "more than 99.9 %"
    assert words.format_percent(0.0) == "less than 0.1 %"
    assert words.format_percent(0.9951) == "99.5 %"
    assert words.format_percent(0.982) == "98 %"
    assert words.format_percent(float("nan")) == "–"


@pytest.mark.parametrize(
    ("value", "sigma", "shown"),
    [
        (-1310.4, 42.3, "-1310 ± 42 u"),
        (0.00549, 0.00021, "0.00549 ± 0.00021 u"),
        (2.7e-5, 3.1e-6, "(2.70 ± 0.31)e-5 u"),
        (0.5, float("nan"), "0.5 u (its error is not known)"),
        (0.5, 0.0, "0.5 u (its error is not known)"),
        (2.5e-4, 2e-10, "0.00025 ± 2e-10 u"),
    ],
)
def test_sizes(value, sigma, shown):
    assert words.format_size(value, sigma, "u") == shown


def test_rounding_is_no_change_of_the_calibration():
    still = CASES["stream"]()
    moved = dataclasses.replace(still, G=still.G + 1e-5 * still.sigma_G)
    assert not words.is_calibration_changed(moved)
    assert words.is_calibration_changed(dataclasses.replace(still, bias=still.bias + 0.01 * still.sigma_bias))
    assert words.describe_calibration_change(moved) == "The causes change nothing in the calibration."


def test_a_share_of_a_gap_that_held_out_data_hardly_show_is_not_stated():
    found = CASES["named"]().closure
    assert words.describe_closure(found).startswith("97 % of the gap is closed")
    scattered = words.describe_closure(dataclasses.replace(found, closed=4.22, interval_90=(1.25, 7.19)))
    assert scattered.startswith("The held-out data show too little of the gap")
    assert "422" not in scattered
    for closed, text in ((1.31, "All of it (69 to 192 %)"), (-0.1, "None of it"), (0.5, "50 % of it")):
        beyond = dataclasses.replace(found, closed=closed, interval_90=(0.69, 1.92))
        assert words.describe_closure_briefly(dataclasses.replace(CASES["named"](), closure=beyond)).startswith(text)


def test_calibration_changes_are_in_ppm_and_degrees_an_hour():
    table = words.tabulate_calibration_change(CASES["named"]()).set_index("parameter")
    assert table.loc["G_zz", ["change", "sigma", "unit", "change in sigma"]].tolist() == ["120", "21", "ppm", "+5.7"]
    assert table.loc["b_z", ["change", "sigma", "unit"]].tolist() == ["0.0800", "0.0090", "deg/h"]
    assert table.loc["b_x", "baseline"] == "-0.540"


# ---- page ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_page_is_whole_and_needs_no_network(pages, case):
    page = checked(pages[case])
    assert set(page.figures) == FIGURES[case]
    assert all(len(alt) > 60 for alt in page.figures.values())


def assert_no_effect_name(diagnosis):
    said = [diagnosis_answers.format_headline(diagnosis), *diagnosis_answers.list_answers(diagnosis).values()]
    assert not re.search(r"[a-z]+_[a-z]+", " ".join(said))


@pytest.mark.parametrize("case", CASES)
def test_page_begins_with_the_answer(pages, case):
    diagnosis = CASES[case]()
    first, rest = re.sub("<figure.*?</figure>", "", pages[case].split("<body>")[1], flags=re.DOTALL).split("<h2", 1)
    first = first.partition("<nav")[0]
    questions = ["Does it agree with the simulator?", "Where not?", "Which cause?", "How sure?", "How far does the gap shrink?"]
    assert re.findall("<dt>(.*?)</dt>", first)[:5] == questions
    assert f"<h1>{escape(diagnosis_answers.format_headline(diagnosis))}</h1>" in first
    assert_no_effect_name(diagnosis)
    assert not any(name in first for name in ALL_EFFECTS)
    assert escape(words.describe_verdict(diagnosis)) in rest
    for cause in diagnosis.causes:
        assert words.format_cause_size(cause) in first
        assert escape(words.explain_effect(cause.effect)) in rest
    assert diagnosis.notes[0] in rest


def test_every_effect_has_a_sentence_of_its_own():
    said = {effect.sentence("y" if effect.axes else None, -2.0, "2.0 u") for effect in ALL_EFFECTS.values()}
    assert len(said) == len(ALL_EFFECTS)
    for name, effect in ALL_EFFECTS.items():
        assert effect.says, name
        assert not re.search(r"[{}_]", effect.sentence(None, 1.0, "2.0 u"))
    assert ALL_EFFECTS["time_offset"].sentence(None, -2.0, "2 s").endswith("2 s early")


def test_pointing_is_the_largest_swing_within_an_orbit():
    t = np.arange(0.0, 9000.0, 60.0)
    table = pd.DataFrame({"cause": "c", "interval": "m1", "axis": "z", "t_s": t, "regressor_deg": t / 3600})
    assert "errs by up to 5400 arcsec about z in an orbit" in pointing_cost.describe_pointing_cost(table, 5400.0)
    assert "3600 arcsec about z in an hour" in pointing_cost.describe_pointing_cost(table, float("nan"))
    ends = table.iloc[[0, -1]]
    assert "arcsec about z in 149 min" in pointing_cost.describe_pointing_cost(ends, 5400.0)
    turned = pointing_cost.describe_pointing_cost(table.assign(cause="reference_orbital:z"), 5400.0)
    assert turned.startswith("The references err by up to 8940 arcsec about z, in m1. An attitude carried by gyro errs only")
    both = pd.concat([table, table.assign(cause="reference_orbital:z")])
    assert pointing_cost.describe_pointing_cost(both, 5400.0) == pointing_cost.describe_pointing_cost(table, 5400.0)
    assert "in the samples" in pointing_cost.describe_pointing_cost(table.iloc[:0], 5400.0)


def test_unlikely_tables():
    # Empty tables, references at the ends only, one interval, odd names, no axis.
    base = CASES["named"]()
    ends = residuals(True, series_s=4500.0)
    few = ends[ends["interval"] == "m2"].assign(interval="a_very_long_name_of_$an$_interval with words")
    empty = {name: getattr(base.details, name).iloc[:0] for name in ("statistics", "explanations", "stream", "regressors")}
    odd = dataclasses.replace(base, details=dataclasses.replace(base.details, residuals=few, **empty))
    assert set(checked(diagnosis_report.build_diagnosis_page(odd)).figures) == {"residuals"}
    statistics = base.details.statistics.assign(axis=None, interval=None)
    assert svg.render_svg(diagnosis_figures.draw_statistics_figure(statistics))


def test_many_references_and_intervals_stay_small():
    base = CASES["named"]()
    parts = [residuals(True, series_s=3.0, seed=k).assign(interval=lambda t, k=k: t["interval"] + f".{k}") for k in range(3)]
    table = pd.concat(parts, ignore_index=True)
    table.loc[table["interval"] == "m3.1", "before_y"] += 1.0
    details = dataclasses.replace(base.details, residuals=table, regressors=regressors(base.causes, table))
    text = diagnosis_report.build_diagnosis_page(dataclasses.replace(base, details=details))
    assert len(text.encode()) < 1_500_000
    assert "The 8 of 18 intervals with the largest residuals" in text
    assert "m3.1" in diagnosis_figures.select_telling_intervals(table, diagnosis_figures.normalise_by_band(table), 8)


def test_significant_cells_are_marked_and_no_others():
    statistics = CASES["named"]().details.statistics
    figure = diagnosis_figures.draw_statistics_figure(statistics)
    stars = sum(text.get_text().endswith("✗") for axes in figure.axes for text in axes.texts)
    order = np.sort(statistics["p_value"].to_numpy())
    below = np.flatnonzero(order <= 0.05 * np.arange(1, order.size + 1) / order.size)
    assert stars == below[-1] + 1 == 12
    clean = diagnosis_figures.draw_statistics_figure(CASES["none"]().details.statistics)
    assert not any(text.get_text().endswith("✗") for axes in clean.axes for text in axes.texts)


def test_the_answers_name_no_more_than_is_sure():
    """What is only likely is hedged, what may yet be on the list is not said to be on none."""
    base, group = CASES["unknown"](), CASES["group"]()
    alternatives = ((("bias_drift:y",), 0.5), (("a remainder",), 0.49), (("rate_lag",), 0.001))
    doubtful = dataclasses.replace(base, unknown_probability=0.49, alternatives=alternatives)
    assert diagnosis_answers.format_headline(doubtful).startswith("There is a gap whose cause is not known")
    assert words.describe_verdict(doubtful).startswith("There is a gap of unknown cause: with a probability of 49 %")
    said = diagnosis_answers.list_answers(doubtful)
    assert (
        said["Which cause?"]
        == "None that could be named. It behaves most like this: the y gyro's bias rises by some amount (50 %)."
    )
    assert_no_effect_name(doubtful)
    alone = dataclasses.replace(group.causes[0], group=("time_offset",), probability=0.85, group_probability=0.85)
    likely = dataclasses.replace(group, causes=(alone,))
    assert diagnosis_answers.format_headline(likely) == "Most likely the gyro's time tags are 0.52 s late"
    assert words.describe_verdict(likely) == "There is a gap, most likely by time_offset, but not surely."


def test_every_stage_has_a_remedy():
    assert set(diagnosis_answers.REMEDIES) == set(STAGE_NAMES)
    assert "time tags" in diagnosis_answers.describe_next_step(CASES["group"]())
    assert diagnosis_answers.describe_next_step(CASES["none"]()) == "Use the calibration as it is."
    assert diagnosis_answers.describe_next_step(CASES["unknown"]()).startswith(
        f"Look at {CASES['unknown']().where[0].interval} first"
    )


def test_a_time_in_an_interval_counts_from_its_start_where_references_are_averaged():
    """The first observation, of references up to 20 s, is at 10 s."""
    residuals = pd.DataFrame({"interval": "slews", "t_s": 1010.0 + 20.0 * np.arange(5)})
    statistics = pd.DataFrame({"interval": ["slews", "slews", "rest"], "start_s": [30.0, 10.0, 0.0]})
    details = Details(residuals, statistics, *[pd.DataFrame()] * 3)
    assert words._locate_interval(1064.0, details) == ", in slews, 64 s after its start"


def test_a_gap_without_a_cause_leaves_no_trust_in_the_calibration():
    """What is at work has moved G and b, and nothing about it is in the model: not even a change is told."""
    for case in ("unknown", "not identifiable"):
        found = dataclasses.replace(CASES[case](), causes=(), present=True)
        off = dataclasses.replace(found, bias=found.bias + 0.01 * found.sigma_bias)
        assert "Do not trust the sigmas" in words.describe_calibration_change(off)
        assert not words.is_calibration_changed(off)
    nothing = dataclasses.replace(CASES["none"](), causes=())
    assert words.describe_calibration_change(nothing) == "The calibration is the baseline's: no cause is in the model."
    beside = dataclasses.replace(CASES["named"](), verdict="unknown")
    assert words.describe_calibration_change(beside).endswith("do not trust the sigmas.")
    assert "trust" not in words.describe_calibration_change(CASES["named"]())


@pytest.mark.usefixtures("blank_figures")
def test_a_partial_answer_says_what_its_causes_close_and_what_to_look_at_first():
    base = CASES["group"]()
    alone = dataclasses.replace(base.causes[0], group=("time_offset",), probability=0.98, group_probability=0.98)
    budget = (Step("baseline", 4.0, 0.1), Step("time_offset", 3.8, 0.1, 0.07, (0.04, 0.13)), Step("remainder", 3.8, 0.1, 0.93))
    left = RemainderSummary(0.93, (0.87, 0.96), (0.0, 0.0, 0.0), (0.3, 0.2, 0.1), 0.0, 0.0, 1.0, "reference", 0.7, ())
    one = dataclasses.replace(base, verdict="partial", causes=(alone,), budget=budget, remainder=left)
    assert diagnosis_answers.format_headline(one).endswith("are 0.52 s late; this closes 7 % of the gap, 93 % is not explained")
    assert diagnosis_answers.describe_next_step(one).startswith("Look at the reference attitudes first")
    two = dataclasses.replace(one, causes=(alone, CASES["named"]().causes[0]))
    assert ", the first of 2 causes; together they close 7 % of the gap" in diagnosis_answers.format_headline(two)
    whole = dataclasses.replace(one, budget=(*budget, Step("floor", 1.0, 0.1)))
    assert len(gap_budget.draw_waterfall(whole.budget).axes) == 1
    first = diagnosis_report.build_diagnosis_page(whole).partition("<dl>")[0]
    assert '<figure id="budget">' in first
    assert "In the model, this cause closes 7 % of the misfit on held-out data; 93 % is not explained." in first

"""A diagnosis on the terminal and on its page, for one of each verdict."""

import dataclasses
import io
import re

import pytest
from markupsafe import escape
from rich.console import Console

from diagnosis.answer import RemainderSummary
from diagnosis.budget import Step
from simulator.effects.sensor import ALL_EFFECTS
from studies.report import diagnosis as report
from studies.report import diagnosis_figures
from tests.diagnosis_cases import CASES
from tests.pages import checked

FIGURES = {"pair": {"cause-bias_orbital-z", "cause-g_matrix_step-z"}, "group": {"cause-time_offset"}}


def summary(diagnosis):
    console = Console(file=io.StringIO(), width=100, emoji=True)
    report.build_diagnosis_page(diagnosis).show(console)
    return console.file.getvalue()


def answers(diagnosis):
    return [report.format_headline(diagnosis), report.describe_closure(diagnosis), *report.list_answers(diagnosis).values()]


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("case", ["pair", "group", "unknown"])
def test_page_begins_with_the_answers_in_plain_words(case):
    diagnosis = CASES[case]()
    text = report.build_diagnosis_page(diagnosis).render_html()
    page = checked(text)
    assert set(page.figures) == {"residuals"} | FIGURES.get(case, set())
    assert all(len(alt) > 60 for alt in page.figures.values())
    first = re.sub("<figure.*?</figure>", "", text.split("<body>")[1], flags=re.DOTALL).partition("<nav")[0].partition("<h2")[0]
    assert all(str(escape(one)) in first for one in answers(diagnosis))
    assert not any(name in first for name in ALL_EFFECTS)
    assert not re.search(r"[a-z]+_[a-z]+", " ".join(answers(diagnosis)))
    for cause in diagnosis.causes:
        assert str(escape(ALL_EFFECTS[cause.effect].meaning or ALL_EFFECTS[cause.effect].summary)) in text


def test_every_effect_has_a_sentence_of_its_own():
    said = {effect.sentence("y" if effect.axes else None, -2.0, "2.0 u") for effect in ALL_EFFECTS.values()}
    assert len(said) == len(ALL_EFFECTS)
    for name, effect in ALL_EFFECTS.items():
        assert effect.says, name
        assert not re.search(r"[{}_]", effect.sentence(None, 1.0, "2.0 u"))
    assert ALL_EFFECTS["time_offset"].sentence(None, -2.0, "2 s").endswith("2 s early")


def test_the_answers_state_no_more_than_is_sure():
    base, group = CASES["unknown"](), CASES["group"]()
    alternatives = ((("bias_drift:y",), 0.5), (("a remainder",), 0.49), (("rate_lag",), 0.001))
    doubtful = dataclasses.replace(base, unknown_probability=0.49, alternatives=alternatives)
    assert report.format_headline(doubtful).startswith("The cause of the misfit is unknown; it may be")
    said = report.list_answers(doubtful)["Which cause?"]
    assert said.startswith(
        "With a probability of 49 % an effect outside the library acts. It behaves most like this: the y gyro's"
    )
    alone = dataclasses.replace(group.causes[0], group=("time_offset",), probability=0.85, group_probability=0.85)
    likely = dataclasses.replace(group, causes=(alone,))
    assert report.format_headline(likely) == "Most likely the gyro's time tags are 0.52 s late"
    scattered = dataclasses.replace(CASES["named"]().closure, closed=4.22, interval_90=(1.25, 7.19))
    said = report.describe_closure(dataclasses.replace(CASES["named"](), closure=scattered))
    assert said.startswith("The held-out data show too little of the misfit")
    assert "422" not in said


@pytest.mark.usefixtures("blank_figures")
def test_a_partial_answer_states_the_share_of_its_causes_and_the_largest_source_of_the_rest():
    base = CASES["group"]()
    alone = dataclasses.replace(base.causes[0], group=("time_offset",), probability=0.98, group_probability=0.98)
    budget = (Step("baseline", 4.0, 0.1), Step("time_offset", 3.8, 0.1, 0.07, (0.04, 0.13)), Step("remainder", 3.8, 0.1, 0.93))
    left = RemainderSummary(0.93, (0.87, 0.96), (0.0, 0.0, 0.0), (0.3, 0.2, 0.1), 0.0, 0.0, 1.0, "reference", 0.7, ())
    one = dataclasses.replace(base, verdict="partial", causes=(alone,), budget=budget, remainder=left)
    said = "are 0.52 s late; this removes 7 % of the misfit, 93 % is not explained (0.087 deg beside 0.05 deg as stated)"
    assert report.format_headline(one).endswith(said)
    assert report.describe_next_step(one).startswith("Look at the reference attitudes first")
    whole = dataclasses.replace(one, budget=(*budget, Step("floor", 1.0, 0.1)))
    assert len(diagnosis_figures.draw_waterfall(whole.budget).axes) == 1
    page = checked(report.build_diagnosis_page(whole).render_html())
    assert {"budget", "residuals"} <= set(page.figures)
    assert "No identified cause explains 93 % (87 to 96 %) of the misfit." in page.words


def test_an_unknown_cause_is_said_to_act_as_random_errors_of_one_kind():
    tags = RemainderSummary(1.0, (1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0025, 0.0, 1.0, "undecided", 0.7, ())
    gyro = dataclasses.replace(tags, time_tags_s=0.0, gyro_deg_h=(40.0, 2.0, 0.0), side="gyro")
    for left, words in (
        (tags, "misfit, as if the time tags were off by 0.0025 s (1 sigma)"),
        (gyro, "misfit, as if the gyro's rate were off by up to 40 deg/h (1 sigma)"),
        (dataclasses.replace(gyro, side="undecided"), "causes the misfit"),
        (dataclasses.replace(tags, reference_deg=(0.1, 0.0, 0.0)), "causes the misfit"),
    ):
        found = report.format_headline(dataclasses.replace(CASES["unknown"](), remainder=left))
        assert words in found
        assert ("as if" in found) == ("as if" in words)

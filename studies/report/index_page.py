"""The page of a reproduction: do simulation and flight agree, where not, by which cause, how sure that is, how far the gap
shrinks, and what would be next; then every claim of both papers, every table and figure, and the
studies, each with its command, commit and hash.

The page is made of the folders of results alone; figures are taken in as they are there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from studies.natanson.claims import NATANSON_CLAIMS as NATANSON
from studies.report import committed_results
from studies.report.claims import Claim, JudgedClaim, PaperResults, judge_claims
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section, make_slug
from studies.report.panels import AXIS_COLOURS, GREY, Line, draw_panels, make_curves, make_forest
from studies.report.source import Source
from studies.report.tables import NO_VALUE
from studies.robertson.claims import ROBERTSON_CLAIMS as ROBERTSON

TITLE = "TRMM simulated beside TRMM flown: gyro calibration and Mission Mode"
PAPERS = {
    "natanson": ("N: Natanson (1998), the gyro calibration", "tables.md", NATANSON),
    "robertson": ("R: Robertson et al. (1999), the Mission Mode", "report.md", ROBERTSON),
}
CLAIM_STYLES = {"agrees": "good", "the paper slips": "bad", "open": "unsure"}
OUTLYING_SIGMAS = 3.0  # sigma
LEADING_FIGURES = ("flight_gap.svg", "ladder.svg")  # figures that a paper's part begins with
ANSWER_PROBABILITY = 0.5  # probability from which on a cause is named in the answer
AGREE = 1.1  # factor between simulated and flown numbers that agree
PERIOD_WORDS = {"precalibration": "before any upload", "calibration1": "with the alignment", "postcalibration": "calibrated"}


def build_index_page(folders: Mapping[str, Path], studies: Path, made: ProvenanceFooter | None = None) -> str:
    """The whole page; a paper without results is left out.

    Parameters
    ----------
    folders : of both papers' results, by name
    studies : folder of the studies' results
    made : for the footer
    """
    found = {
        name: PaperResults(results, studies) for name, folder in folders.items() if (results := committed_results.read(folder))
    }
    claims = {name: judge_claims(PAPERS[name][2], one) for name, one in found.items()}
    evidence = [
        section for name, one in found.items() for section in _build_paper_sections(name, Source.load(one.results.folder))
    ]
    evidence += [*_build_study_sections(studies)]
    answers = [_build_answers(name, one, claims[name]) for name, one in found.items()]
    sections = [*answers, *_build_claim_sections(claims, {one.name for one in evidence}), *evidence]
    return Page(TITLE, sections, _build_first_screen(found), made).render_html()


# ---- the first screen ----------------------------------------------------------------------------------------------------


def _build_first_screen(found: Mapping[str, PaperResults]) -> Answer | None:
    """Simulated against flown numbers of both papers; none if a run has not flown both."""
    try:
        gap, rungs = found["natanson"].table("flight_gap"), found["robertson"].table("ladder")
        clean, rms = (found["natanson"][name] for name in ("clean_gap_rms_deg.assumed", "flight_gap_rms_deg.flight_rms"))
    except KeyError:
        return None
    first, last = rungs["factor_unfitted"].iloc[[0, -1]]
    picture = Picture(
        "agreement",
        partial(draw_agreement, gap, rungs),
        f"Left: 18 simulated attitude residuals against the flown ones, near the line of slope 1. Right: the factor between "
        f"simulated and flown numbers of the Mission Mode, from {first:.2f} to {last:.2f}.",
        "Left: N's residuals before calibration, a mark an interval; on the line simulation and flight agree. Right: R's "
        "Mission Mode, the RMS factor of the numbers that no size was fitted on; each effect is put in after those above it, "
        "bars are 16 to 84 % over time windows drawn anew, and 1 is agreement.",
    )
    sentence = (
        f"With the flight's own G and b, which is circular, the simulator predicts N's 18 differences of flown residuals, "
        f"{rms:.3f} deg RMS, to {clean:.4f} deg; it predicts R's numbers that no size was fitted on to a factor of {last:.2f}."
    )
    return Answer("open", picture, sentence)


def draw_agreement(gap: pd.DataFrame, rungs: pd.DataFrame) -> Figure:
    """Draw N's residuals, simulated against flown, and the ladder of R's effects."""
    ends = [gap["flight_deg"].min(), gap["flight_deg"].max()]
    marks = zip(gap.groupby("axis", sort=False), AXIS_COLOURS.values(), "os^", strict=True)
    lines = [Line(ends, ends, "", GREY, "-")]
    lines += [Line(part["flight_deg"], part["predicted_deg"], str(axis), colour, mark) for (axis, part), colour, mark in marks]
    left = make_curves(
        lines, title="N: residuals before calibration", x="flown (deg)", y="simulated (deg)", legend="upper left"
    )
    ranges = [(rungs["factor_unfitted"] - rungs[f"factor_unfitted_{end}"]).abs() for end in ("low", "high")]
    names = [_translate_name(str(name)) for name in rungs["effect"]]
    title = "R: simulated over flown numbers"
    right = make_forest(names, rungs["factor_unfitted"], ranges, at=[1.0], title=title, x="RMS factor")
    return draw_panels(left, right, size=(8.0, 4.0))


def _build_answers(name: str, found: PaperResults, claims: Sequence[JudgedClaim]) -> Section:
    """Do they agree, where not, by which cause, how sure is it, how far does the gap shrink, and what would be next."""
    try:
        lines = _build_natanson_answers(found, claims) if name == "natanson" else _build_robertson_answers(found, claims)
    except (KeyError, IndexError):
        lines = {"Do they agree?": "This run did not fly what it takes to say."}
    return Section(f"Answers for {name.capitalize()}", [lines])


def _count_verdicts(claims: Sequence[JudgedClaim]) -> str:
    count = {verdict: sum(one.verdict == verdict for one in claims) for verdict in CLAIM_STYLES}
    return (
        f"Of {len(claims)} claims {count['agrees']} agree, in {count['the paper slips']} the paper slips, "
        f"{count['open']} are open."
    )


def _build_natanson_answers(found: PaperResults, claims: Sequence[JudgedClaim]) -> dict[str, str]:
    clean, rms = found["clean_gap_rms_deg.assumed"], found["flight_gap_rms_deg.flight_rms"]

    def scan(name: str) -> Any:
        return found[f"clean_gap_scan_deg.{name}"]

    held = [scan(f"held_out.{when}") for when in ("before", "after")]
    agree = clean < 0.1 * rms
    first = "The motion does, the calibration is put in" if agree else "No"
    slips = [one.claim.about or one.claim.where for one in claims if one.verdict == "the paper slips"]
    slipped = f"Where the paper slips: {'; '.join(slips)}." if slips else ""
    return {
        "Do simulation and flight agree?": f"{first}: with the flight's own published G and b as truth, which is circular, the "
        f"18 differences between flown residuals before and after calibration, {rms:.3f} deg RMS, are predicted to {clean:.4f} "
        f"deg. {_count_verdicts(claims)}",
        "Where not?": f"Most in {_describe_largest_gap(found.table('flight_gap'))}. {slipped}",
        "Which cause?": f"The slews' timings, which are not published, are assumed: fitted, they explain {clean:.4f} to "
        f"{found['clean_gap_rms_deg.each']:.4f} deg; print alone leaves {scan('print'):.4f}.",
        "How sure?": f"Of {scan('timings')} timings tried, which leave {scan('min'):.4f} to {scan('max'):.4f} deg, "
        f"{100 * scan('share_below_assumed'):.0f} % leave less than those assumed. The truth flown is the flight's own "
        "calibration, so that agreement below its noise proves little.",
        "How far does the gap shrink?": f"To {found['clean_gap_rms_deg.common']:.4f} deg with four common timings, "
        f"{found['clean_gap_rms_deg.each']:.4f} with nine; on intervals that fitted nothing from {held[0]:.4f} to "
        f"{held[1]:.4f}.",
        "What next?": "The true times of the slews, or the gyro's samples of one maneuver: no paper prints them, and nothing "
        "else would tell what is left.",
    }


def _describe_largest_gap(gap: pd.DataFrame) -> str:
    """Describe the place of the largest clean gap by two of its numbers."""
    worst = gap.reindex(gap["clean_gap_deg"].abs().sort_values(ascending=False).index).head(2)
    return " and ".join(f"interval {one.interval}, {one.axis}, by {one.clean_gap_deg:+.4f} deg" for one in worst.itertuples())


def _build_robertson_answers(found: PaperResults, claims: Sequence[JudgedClaim]) -> dict[str, str]:
    rungs, left = found.table("ladder"), found.table("diagnosis_left")
    first, last = rungs.iloc[0], rungs.iloc[-1]
    far = left[left["left_sigmas"].abs() > OUTLYING_SIGMAS]
    steps = "; ".join(f"{_translate_name(str(one.effect))} {one.factor_18:.2f}" for one in rungs.iloc[1:].itertuples())
    causes = found.table("diagnosis")
    listed = causes[(causes["probability"] > ANSWER_PROBABILITY) & ~causes["cause"].str.startswith("unknown")]
    probable = "".join(f"; {_translate_name(str(one.cause))} {one.probability:.2f}" for one in listed.itertuples())
    where = ", ".join(f"{_translate_name(str(one.number))} by {one.left_sigmas:+.1f} sigma" for one in far.itertuples())
    names = " and ".join(_translate_name(str(one)) for one in far["number"])
    agree = last["factor_unfitted_low"] < AGREE
    return {
        "Do simulation and flight agree?": f"{'Yes' if agree else 'In part'}: R Table 3's 18 numbers differ by a factor of "
        f"{first['factor_18']:.2f} as landed. {_count_verdicts(claims)}",
        "Where not?": f"With what is found put in: {where}." if where else "Nowhere by more than three sigma.",
        "Which cause?": f"Several; the factor with each put in after the one before: {steps}. The rest is unknown.",
        "How sure?": f"Probabilities: something that is on no list {found['diagnosis.unknown']:.2f}{probable}.",
        "How far does the gap shrink?": f"From a factor of {first['factor_unfitted']:.2f} to {last['factor_unfitted']:.2f} "
        f"({last['factor_unfitted_low']:.2f} to {last['factor_unfitted_high']:.2f}), on numbers that fitted nothing.",
        "What next?": f"Telemetry of the days behind {names}: no effect on the list explains what is left of them."
        if names
        else "Nothing is left that more flight data would have to explain.",
    }


def _translate_name(name: str) -> str:
    """A number, rung or cause of R's ladder in words."""
    for key, text in PERIOD_WORDS.items():
        name = name.replace(key, text)
    return name.replace("_", " ").replace("gyro walk:", "a walk of gyro ")


# ---- claims and evidence -------------------------------------------------------------------------------------------------


def _build_claim_sections(claims: Mapping[str, Sequence[JudgedClaim]], there: Collection[str]) -> Iterator[Section]:
    """A row a claim; its evidence is linked if it is among the sections of the page."""
    if claims:
        yield Section("Every claim of both papers", [])
    for name, found in claims.items():
        rows = pd.DataFrame(
            {
                "where": [one.claim.where for one in found],
                "the paper says": [one.claim.text for one in found],
                "verdict": [
                    Markup('<span class="{}">{}</span>').format(CLAIM_STYLES[one.verdict], one.verdict) for one in found
                ],
                "found": [one.found for one in found],
                "evidence": [_build_link(format_anchor(name, one.claim), there) for one in found],
            },
            dtype=object,
        )
        title = f"Claims of {PAPERS[name][0]}"
        yield Section(title, [_count_verdicts(found), PageTable(rows, label=title)], 3)


def _build_link(target: str, there: Collection[str]) -> str:
    return Markup('<a href="#{}">see</a>').format(target) if target in there else NO_VALUE


def format_anchor(paper: str, claim: Claim) -> str:
    """The anchor of a claim's evidence."""
    return make_slug(claim.evidence) if claim.evidence.startswith("Study ") else f"{paper}-{make_slug(claim.evidence)}"


def _build_paper_sections(name: str, source: Source) -> Iterator[Section]:
    """Every figure and table of a paper's reproduction."""
    title, file, _ = PAPERS[name]
    sections = list(source.sections(file, 3, lambda section: f"{name}-{make_slug(section)}"))
    shown = {one.name for section in sections for one in section.items if isinstance(one, Picture)}
    others = [path.name for path in sorted(source.folder.glob("*.svg")) if f"{source.folder.name}-{path.stem}" not in shown]
    others.sort(key=lambda one: one not in LEADING_FIGURES)
    figures: list[Item] = [item for one in others for item in source.figure(one, _find_caption(one))]
    yield Section(title, figures)
    yield from sections
    yield Section("", [source.describe_origin(file)])


def _find_caption(file: str) -> str:
    """Find the caption of a figure of N by its file."""
    return CAPTIONS.get(file, file.removesuffix(".svg").replace("_", " "))


CAPTIONS = {
    "figure1_yaw_maneuvers.svg": "N Figure 1: body rates during both yaw maneuvers, simulated.",
    "figure2_minus_y_forward.svg": "N Figure 2: body rates in -y forward, simulated.",
    "figure3_inertial_hold.svg": "N Figure 3: body rates during inertial hold, simulated.",
    "flight_gap.svg": "Residuals before calibration, flown and predicted, with the simulated 5 to 95 % range over seeds; "
    "below, the clean gap.",
    "errors.svg": "Recovered minus injected parameters over their formal sigma, a stroke a case.",
    "psi_sweep.svg": "Linear against full ψ over slew rate and step.",
}


# ---- checks and studies --------------------------------------------------------------------------------------------------


def _build_study_sections(studies: Path) -> Iterator[Section]:
    """Every study's report, folded."""
    folders = [folder for folder in sorted(studies.glob("*/")) if (folder / "report.md").is_file()]
    if folders:
        yield Section("The studies", [])
    for folder in folders:
        source = Source.load(folder)
        title, anchor = source.title("report.md").removeprefix(f"Study {folder.name}: "), f"study-{make_slug(folder.name)}"
        items: list[Item] = []
        for one in source.sections("report.md", 4, make_slug):
            items += [Markup("<h4>{}</h4>").format(one.title) if one.title else "", *one.items]
        yield Section(title, [*items, source.describe_origin("report.md")], 3, anchor, is_folded=True)

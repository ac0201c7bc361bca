"""The page of the reproduction: two pictures and a sentence, then both papers' tables and figures, then their claims.

Tables show the flight's values beside the simulated ones and the difference. The page is made from the folders of results.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from studies.natanson import reproduce as natanson
from studies.natanson.claims import NATANSON_CLAIMS
from studies.report import committed_results
from studies.report.claims import Claim, PaperResults, judge_claims
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section, SmallParagraph, make_slug
from studies.report.panels import AXIS_COLOURS, GREY, Line, draw_panels, make_curves, make_forest
from studies.report.tables import Table
from studies.robertson import reproduce as robertson
from studies.robertson.claims import ROBERTSON_CLAIMS
from studies.robertson.figures import MISSION_FIGURE_TITLES

TITLE = "TRMM simulated beside TRMM flown: gyro calibration and Mission Mode"
VERDICT_STYLES = {"agrees": "good", "the paper slips": "bad", "our reading": "quiet", "open": "unsure"}
VERDICT_MEANINGS = {
    "agrees": "simulation and paper agree.",
    "the paper slips": "a printed equation, sign or digit contradicts the paper's own numbers.",
    "our reading": "the reproduction finds something else, but the paper does not contradict itself.",
    "open": "the reproduction does not decide the claim.",
}
RUNG_NAMES = {
    "landed": "level boresights, printed coefficients",
    "ground batch": "accuracy against the ground batch",
    "boresight_elevation": "boresights raised by 29.4°",
    "computed coefficients": "computed sensor coefficients",
    "horizon_noise": "horizon noise",
    "gyro_walk:y": "random walk of the y bias",
}


class Paper(NamedTuple):
    """What the page shows of a paper."""

    title: str
    claims: Sequence[Claim]
    build_tables: Callable[[dict[str, pd.DataFrame]], list[Table]]  # beside the flight's values, from those of the CSV files
    figures: Mapping[str, str]  # titles by file name


PAPERS = {
    "natanson": Paper(
        "N: Natanson (1998), the gyro calibration", NATANSON_CLAIMS, natanson.build_page_tables, natanson.FIGURE_TITLES
    ),
    "robertson": Paper(
        "R: Robertson et al. (1999), the Mission Mode", ROBERTSON_CLAIMS, robertson.build_page_tables, MISSION_FIGURE_TITLES
    ),
}


def build_index_page(folders: Mapping[str, Path], studies: Path, provenance: ProvenanceFooter | None = None) -> str:
    """Build the whole page from the folders of both papers' and of the studies' results; a paper without any is left out."""
    papers = {
        name: PaperResults(reproduction, studies)
        for name, folder in folders.items()
        if (reproduction := committed_results.read(folder))
    }
    answer, pictures = _build_first_screen(papers)
    sections = [Section("", [pictures])]
    for name, results in papers.items():
        sections += _build_paper_sections(PAPERS[name], results)
    if papers:
        meanings = [f"{verdict}: {meaning}" for verdict, meaning in VERDICT_MEANINGS.items()]
        sections.append(Section("Claims", [meanings]))
    sections += [_build_claim_section(PAPERS[name], results) for name, results in papers.items()]
    return Page(TITLE, sections, answer, provenance).render_html()


def _build_first_screen(papers: Mapping[str, PaperResults]) -> tuple[Answer | None, list[Picture]]:
    """Build the answer and its pictures, simulated against flown; nothing unless both papers are simulated."""
    try:
        gap, rungs = papers["natanson"].table("flight_gap"), papers["robertson"].table("ladder")
        clean, rms = (papers["natanson"][name] for name in ("clean_gap_rms_deg.assumed", "flight_gap_rms_deg.flight_rms"))
    except KeyError:
        return None, []
    first, last = rungs["factor_unfitted"].iloc[[0, -1]]
    residuals = Picture(
        "residuals",
        partial(draw_residuals, gap),
        "18 simulated attitude residuals against the flown ones, close to the line of equality.",
        "N: residuals before calibration, one mark for each interval and axis. On the line simulation and flight are equal.",
    )
    factors = Picture(
        "factors",
        partial(draw_factors, rungs),
        f"Factor between simulated and flown numbers of the Mission Mode, from {first:.2f} to {last:.2f}.",
        "R: factor between simulated and flown numbers of R Table 3 that no size was fitted to; 1 is agreement. Each line adds "
        "an effect to those above. Bars: 16 to 84 % over resampled time windows.",
    )
    sentence = (
        f"Given the flight's own calibration as truth, the simulator predicts N's 18 differences of residuals before and after "
        f"calibration, {rms:.3f} deg RMS, to {clean:.4f} deg. It predicts the numbers of R that no size was fitted to within a "
        f"factor of {last:.2f}."
    )
    return Answer("open", None, sentence), [residuals, factors]


def draw_residuals(gap: pd.DataFrame) -> Figure:
    """Draw N's residuals before calibration, simulated against flown."""
    ends = [gap["flight_deg"].min(), gap["flight_deg"].max()]
    marks = zip(gap.groupby("axis", sort=False), AXIS_COLOURS.values(), "os^", strict=True)
    lines = [Line(ends, ends, "", GREY, "-")]
    lines += [Line(part["flight_deg"], part["predicted_deg"], str(axis), colour, mark) for (axis, part), colour, mark in marks]
    return draw_panels(make_curves(lines, x="flown (deg)", y="simulated (deg)", legend="upper left"), size=(4.6, 3.6))


def draw_factors(rungs: pd.DataFrame) -> Figure:
    """Draw the factor between simulated and flown numbers of R Table 3, an effect added on each line."""
    ranges = [(rungs["factor_unfitted"] - rungs[f"factor_unfitted_{end}"]).abs() for end in ("low", "high")]
    names = [RUNG_NAMES[str(name)] for name in rungs["effect"]]
    return draw_panels(make_forest(names, rungs["factor_unfitted"], ranges, at=[1.0], x="RMS factor"), size=(4.6, 3.6))


def _build_paper_sections(paper: Paper, results: PaperResults) -> Iterator[Section]:
    """Build the sections of a paper: every table beside the flight's values, and every figure."""
    folder = results.reproduction.folder
    yield Section(paper.title, [SmallParagraph(describe_origin(folder))])
    try:
        tables = paper.build_tables(results.reproduction.tables)
    except KeyError:
        tables = []
    for title, parts in groupby(tables, lambda table: table.title.partition(", Δt")[0]):
        steps = list(parts)
        yield Section(title, [steps[0].note, [_build_page_table(table) for table in steps]], 3)
    for name, title in paper.figures.items():
        path = folder / f"{name}.svg"
        if path.is_file():
            yield Section(title, [Picture(f"{folder.name}-{name}", path.read_bytes, title, "")], 3)


def _build_page_table(table: Table) -> PageTable:
    """Build a table whose first heading is the step."""
    step = table.title.partition(", ")[2] if "Δt" in table.title else "number"
    return PageTable(table.data.rename(columns={"number": step}), label=table.title)


def describe_origin(folder: Path) -> str:
    """Describe which command made a folder of results, and from which commit."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    commit = manifest.get("commit") or "unknown"
    short_commit = f"{commit[:12]}{commit[40:]}"  # "+changes" follows the forty digits of an unclean source
    return f"{manifest.get('command', '')}, commit {short_commit}; {folder.name}/manifest.json has the hash of each file."


def _build_claim_section(paper: Paper, results: PaperResults) -> Section:
    """Build the section of the claims with their verdicts and findings."""
    judged = judge_claims(paper.claims, results)
    counts = {verdict: sum(judgement.verdict == verdict for judgement in judged) for verdict in VERDICT_STYLES}
    count = f"{len(judged)} claims; {'; '.join(f'{verdict}: {number}' for verdict, number in counts.items() if number)}."
    answers: Item = {
        f"{judgement.claim.where}: {judgement.claim.text}": Markup('<span class="{}">{}.</span> {}').format(
            VERDICT_STYLES[judgement.verdict], judgement.verdict.capitalize(), judgement.finding
        )
        for judgement in judged
    }
    return Section(f"Claims of {paper.title}", [count, answers], 3, make_slug(f"claims {paper.title}"))

"""The page of a reproduction: do simulation and flight agree, where not, by which cause, how sure that is, how far the gap
shrinks, and what would be next; then every claim of both papers, every table and figure, the first-sight exams of the
diagnosis, and the studies, each with what makes it again.

The page is made of the folders of results alone, so that it says what they hold; figures are taken in as they are there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from studies.montecarlo.files import write_text
from studies.natanson.claims import CLAIMS as NATANSON
from studies.report import committed, html, markdown
from studies.report.claims import Claim, Found, Judged, judged
from studies.report.html import Html, folded, heading, paragraph, slug, table_of
from studies.report.made import Made
from studies.report.source import Source
from studies.report.tables import NO_VALUE
from studies.robertson.claims import CLAIMS as ROBERTSON

TITLE = "TRMM simulated beside TRMM flown: gyro calibration and Mission Mode"
PAPERS = {
    "natanson": ("N: Natanson (1998), the gyro calibration", "tables.md", NATANSON),
    "robertson": ("R: Robertson et al. (1999), the Mission Mode", "report.md", ROBERTSON),
}
KINDS = {"agrees": "good", "the paper slips": "bad", "open": "open"}
FAR = 3.0  # sigma
FIRST = ("flight_gap.svg", "ladder.svg")  # figures that a paper's part begins with
WORTH = 0.5  # probability from which on a cause is named in the answer
AGREE = 1.1  # factor between simulated and flown numbers that agree
PERIOD_WORDS = {"precalibration": "before any upload", "calibration1": "with the alignment", "postcalibration": "calibrated"}


def write(path: Path, folders: Mapping[str, Path], studies: Path, made: Made) -> None:
    """Write the page.

    Parameters
    ----------
    path : of the page
    folders : of both papers' results, by name
    studies : folder of the studies' results
    made : for the footer
    """
    write_text(path, page(folders, studies, made))


def page(folders: Mapping[str, Path], studies: Path, made: Made | None = None) -> str:
    """The whole page; a paper without results is left out."""
    found = {name: Found(results, studies) for name, folder in folders.items() if (results := committed.read(folder))}
    claims = {name: judged(PAPERS[name][2], one) for name, one in found.items()}
    evidence = "".join(_paper(name, Source.of(one.results.folder)) for name, one in found.items())
    evidence += _exams() + _studies(studies)
    there = set(re.findall(r'\bid="([^"]+)"', evidence))
    return html.document(TITLE, [_answers(found, claims), _claims(claims, there), evidence], made, contents=True)


# ---- the first screen ----------------------------------------------------------------------------------------------------


def _answers(found: Mapping[str, Found], claims: Mapping[str, Sequence[Judged]]) -> str:
    """Do they agree, where not, by which cause, how sure is it, how far does the gap shrink, and what would be next."""
    cards = []
    for name, make in (("natanson", _natanson), ("robertson", _robertson)):
        if name in found:
            try:
                kind, lines = make(found[name], claims[name])
            except (KeyError, IndexError):
                kind, lines = "open", {"Do they agree?": "This run did not fly what it takes to say."}
            items = "".join(f"<dt>{escape(question)}</dt><dd>{escape(text)}</dd>" for question, text in lines.items())
            cards.append(f'<div class="answer {kind}"><p class="verdict">{escape(PAPERS[name][0])}</p><dl>{items}</dl></div>')
    return f'<section aria-label="The answer"><div class="cards">{"".join(cards)}</div></section>\n'


def _counts(claims: Sequence[Judged]) -> str:
    count = {verdict: sum(one.verdict == verdict for one in claims) for verdict in KINDS}
    return (
        f"Of {len(claims)} claims {count['agrees']} agree, in {count['the paper slips']} the paper slips, "
        f"{count['open']} are open."
    )


def _natanson(found: Found, claims: Sequence[Judged]) -> tuple[str, dict[str, str]]:
    clean, rms = found["clean_gap_rms_deg.assumed"], found["flight_gap_rms_deg.flight_rms"]

    def scan(name: str) -> Any:
        return found[f"clean_gap_scan_deg.{name}"]

    held = [scan(f"held_out.{when}") for when in ("before", "after")]
    agree = clean < 0.1 * rms
    first = "The motion does, the calibration is put in" if agree else "No"
    slips = [one.claim.about or one.claim.where for one in claims if one.verdict == "the paper slips"]
    slipped = f"Where the paper slips: {'; '.join(slips)}." if slips else ""
    return ("" if agree else "gap"), {
        "Do simulation and flight agree?": f"{first}: with the flight's own published G and b as truth, which is circular, the "
        f"18 differences between flown residuals before and after calibration, {rms:.3f} deg RMS, are predicted to {clean:.4f} "
        f"deg. {_counts(claims)}",
        "Where not?": f"Most in {_most(found.table('flight_gap'))}. {slipped}",
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


def _most(gap: pd.DataFrame) -> str:
    """Where the clean gap is largest: two of its numbers."""
    worst = gap.reindex(gap["clean_gap_deg"].abs().sort_values(ascending=False).index).head(2)
    return " and ".join(f"interval {one.interval}, {one.axis}, by {one.clean_gap_deg:+.4f} deg" for one in worst.itertuples())


def _robertson(found: Found, claims: Sequence[Judged]) -> tuple[str, dict[str, str]]:
    rungs, left = found.table("ladder"), found.table("diagnosis_left")
    first, last = rungs.iloc[0], rungs.iloc[-1]
    far = left[left["left_sigmas"].abs() > FAR]
    steps = "; ".join(f"{_plain(str(one.effect))} {one.factor_18:.2f}" for one in rungs.iloc[1:].itertuples())
    causes = found.table("diagnosis")
    listed = causes[(causes["probability"] > WORTH) & ~causes["cause"].str.startswith("unknown")]
    probable = "".join(f"; {_plain(str(one.cause))} {one.probability:.2f}" for one in listed.itertuples())
    where = ", ".join(f"{_plain(str(one.number))} by {one.left_sigmas:+.1f} sigma" for one in far.itertuples())
    names = " and ".join(_plain(str(one)) for one in far["number"])
    agree = last["factor_unfitted_low"] < AGREE
    return ("" if agree else "gap"), {
        "Do simulation and flight agree?": f"{'Yes' if agree else 'In part'}: R Table 3's 18 numbers differ by a factor of "
        f"{first['factor_18']:.2f} as landed. {_counts(claims)}",
        "Where not?": f"With what is found put in: {where}." if where else "Nowhere by more than three sigma.",
        "Which cause?": f"Several; the factor with each put in after the one before: {steps}. The rest is unknown.",
        "How sure?": f"Probabilities: something that is on no list {found['diagnosis.unknown']:.2f}{probable}.",
        "How far does the gap shrink?": f"From a factor of {first['factor_unfitted']:.2f} to {last['factor_unfitted']:.2f} "
        f"({last['factor_unfitted_low']:.2f} to {last['factor_unfitted_high']:.2f}), on numbers that fitted nothing.",
        "What next?": f"Telemetry of the days behind {names}: no effect on the list explains what is left of them."
        if names
        else "Nothing is left that more flight data would have to explain.",
    }


def _plain(name: str) -> str:
    """A number, rung or cause of R's ladder in words."""
    for key, text in PERIOD_WORDS.items():
        name = name.replace(key, text)
    return name.replace("_", " ").replace("gyro walk:", "a walk of gyro ")


# ---- claims and evidence -------------------------------------------------------------------------------------------------


def _claims(claims: Mapping[str, Sequence[Judged]], there: Collection[str]) -> str:
    """A row a claim; its evidence is linked if it is among what is there."""
    parts = [heading("Every claim of both papers")] if claims else []
    for name, found in claims.items():
        rows = pd.DataFrame(
            {
                "where": [one.claim.where for one in found],
                "the paper says": [one.claim.text for one in found],
                "verdict": [Html(f'<span class="word {KINDS[one.verdict]}">{one.verdict}</span>') for one in found],
                "found": [one.found for one in found],
                "evidence": [_link(anchor(name, one.claim), one.claim, there) for one in found],
            },
            dtype=object,
        )
        parts += [f"<h3>{escape(PAPERS[name][0])}</h3>\n", paragraph(_counts(found))]
        parts.append(table_of(rows, label=f"Claims of {PAPERS[name][0]}"))
    return "".join(parts)


def _link(target: str, claim: Claim, there: Collection[str]) -> Html:
    if target not in there:
        return Html(NO_VALUE)
    return Html(f'<a href="#{target}">see<span class="sr"> {escape(claim.where)}</span></a>')


def anchor(paper: str, claim: Claim) -> str:
    """The anchor of a claim's evidence."""
    return slug(claim.evidence) if claim.evidence.startswith("Study ") else f"{paper}-{slug(claim.evidence)}"


def _paper(name: str, source: Source) -> str:
    """Every figure and table of a paper's reproduction."""
    title, file, _ = PAPERS[name]
    text = (source.folder / file).read_text(encoding="utf-8") if (source.folder / file).is_file() else ""
    drawn: dict[str, str] = {}

    def image(path: str, alt: str) -> str:
        drawn[path] = alt
        return source.figure(path, alt)

    bodies = []
    for section in markdown.sections(text):
        own = f"{name}-{slug(section.title)}"
        body = markdown.rendered(section, image)
        bodies.append(f'<h3 id="{own}">{escape(section.title)}</h3>\n{body}' if section.title else body)
    others = [path.name for path in sorted(source.folder.glob("*.svg")) if path.name not in drawn]
    others.sort(key=lambda one: one not in FIRST)
    figures = "".join(source.figure(one, _caption(one)) for one in others)
    return f"{heading(title)}{figures}{''.join(bodies)}{source.made(file)}"


def _caption(file: str) -> str:
    """What a figure of N shows, by its file."""
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


def _exams() -> str:
    """Tabulate every first-sight exam; they are part of a checkout, and an installed package has none."""
    folder = Path(__file__).parents[1] / "validation" / "exam"
    scores = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*/score.json"))]
    if not scores:
        return ""
    rows = [
        {"exam": one["exam"], "what": rate["what"], "cases": rate["cases"], "share": rate["share"], "low": rate["low"]}
        | {"high": rate["high"]}
        for one in scores
        for rate in one["rates"]
    ]
    lead = paragraph(
        "Each exam is taken once, on craft and effects written after the code was frozen and without sight of it. The "
        "hash of its keys was committed before it ran. Shares have 95 % binomial intervals."
    )
    return f"{heading('How far the diagnosis can be believed')}{lead}{table_of(pd.DataFrame(rows))}"


def _studies(studies: Path) -> str:
    names = [folder.name for folder in sorted(studies.glob("*/"))]
    parts = [_study(studies / name) for name in names]
    found = "".join(part for part in parts if part)
    return f"{heading('The studies')}{found}" if found else ""


def _study(folder: Path) -> str:
    """A study's report, folded."""
    path = folder / "report.md"
    if not path.is_file():
        return ""
    source, text = Source.of(folder), path.read_text(encoding="utf-8")
    name = text.splitlines()[0].removeprefix("# ").removeprefix(f"Study {folder.name}: ")
    head = f'<h3 id="study-{slug(folder.name)}">{escape(name)}</h3>\n'
    body = source.sections(markdown.sections(text), 4) + source.made("report.md")
    return head + folded(f"{folder.name}: tables and figures", body)

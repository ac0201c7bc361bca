"""The examples of README and docstrings run as they stand."""

import doctest
import json
import re
from pathlib import Path

import simulator.scenario

ROOT = Path(__file__).parents[1]


def test_readme_examples(capsys):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert len(blocks) == 2
    namespace = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), namespace)
    assert "G_xx" in capsys.readouterr().out


def test_docstring_examples():
    for module in (simulator, simulator.scenario):
        result = doctest.testmod(module)
        assert result.attempted > 0
        assert result.failed == 0


def test_numbers_the_readme_quotes_are_those_committed():
    """Each figure of the README's table is in the committed summary, to the digits quoted."""
    text = (ROOT / "README.md").read_text()
    summary = json.loads((ROOT / "results" / "reproduction" / "summary.json").read_text())
    quoted = [
        f"{summary['bias_in_standard_errors_max']:.1f} standard errors",
        f"NEES {summary['nees']['value']:.1f} in [{summary['nees']['bounds'][0]:.1f}, {summary['nees']['bounds'][1]:.1f}]",
        f"NEES {summary['nees_references_only']['value']:.1f}",
        "{:.0f} / {:.0f} / {:.2f} %".format(*(100 * summary["coverage"][level] for level in ("68", "95", "99.7"))),
        f"gap is {summary['flight_gap_rms_deg']['published']:.3f} deg RMS",
        f"own RMS is {summary['flight_gap_rms_deg']['flight_rms']:.3f} deg",
        f"left is {summary['flight_gap_rms_deg']['floor']:.3f} deg",
        f"misses by {summary['minus_y_rate_rpo']['gap_rms_deg']['1']:.2f} deg",
        f"({summary['minus_y_rate_rpo']['fitted_gap_rms_deg']['1']:.2f} with its best timing)",
        f"{summary['second_iteration_median']['G']:.0e}".replace("e-0", "e-") + " (median)",
        f"{summary['psi_difference_max']['G']:.0e}".replace("e-0", "e-") + " in G",
    ]
    assert [phrase for phrase in quoted if phrase not in text] == []

"""Whatever is wrong with a command, one line says it before the work, with exit status 2."""

import shutil

import pytest
from click.testing import CliRunner

from studies.cli.main import main

WRONG = [
    # the program and its commands
    ("--nothing", "gyrocal: No such option"),
    ("simulat trmm OUT", "No such command 'simulat'; did you mean simulate?"),
    # files to read and to write
    ("calibrate \x1b[31mred", r"\x1b[31mred: not a folder"),
    ("calibrate REC --json no/such/folder/x.json", "no folder no/such/folder"),
    ("calibrate REC --json same --report same", "need files of their own"),
    ("calibrate REC --truth REC/recording.toml", "not a truth file"),
    ("diagnose REC --report -", "give the name of a file"),
    ("simulate trmm REC", "--force"),
    ("baseline REC/recording.toml", "is not known"),
    # scenarios, studies and effects
    ("simulate trm OUT", "trm: neither a file nor a built-in scenario; did you mean trmm"),
    ("plan trmm --effect bias_orbitl", "did you mean bias_orbital"),
    ("study pape", "pape: no such study; did you mean paper?"),
    ("study psi --require p99(nees)<1", "the cases of this study are points of a grid"),
    ("study paper --fail-on fail", "--fail-on fail: give failed, until or require"),
    ("study paper --limit 10m", "--limit 10m: give a time such as 30s, 10min or 2h"),
    ("study paper --cases 5 --rerun 7", "cases 0 to 4"),
    ("study consistency --cases 2 --out OUT", "more than 24 are needed"),
    # values
    ("simulate trmm OUT --set gyro.sample_s", "PATH=VALUE"),
    ("calibrate REC --step 0.7", "multiple"),
    ("calibrate REC --solve-for G_ab", "unknown parameter"),
    ("calibrate REC --prior-sigma-g 1e-3", "both"),
    *((f"calibrate REC --fail-on p{text}", "give NAME<LIMIT or NAME>LIMIT") for text in ("<", "<nan")),
    ("calibrate REC --max-sigma 3", "give the saved result with --against"),
    ("calibrate REC --against REC/recording.toml", "not a result of 'gyrocal calibrate --json'"),
    *((f"calibrate REC --against a --max-sigma {text}", f"--max-sigma {text}: must be") for text in ("nan", "0")),
    *(
        (f"calibrate REC --against a --max-change {text}", message)
        for text, message in (("G_zz", "give NAME<LIMIT"), ("b_x<1ppm", "no unit of b_x"))
    ),
    ("predict REC --from 10 --prior-scale nan", "sigma_scale nan"),
    *((f"mission OUT --days {days}", text) for days, text in (("nan", "--days nan"), ("0", "one cycle"), ("1e9", "1000 days"))),
    *((f"mission OUT --days 1 --every {every}", "must be a multiple of the cycle") for every in ("0.7", "inf")),
    ("reproduce --paper robertson --days 0.5", "between 1 and 200"),
    # adopted scenarios and sensors
    ("compare REC trmm trmm", "give each scenario once"),
    ("diagnose REC --adopt same --json same", "need files of their own"),
    ("simulate REC OUT --draw", "no posterior to draw from"),
    ("simulate trmm OUT --effect dss_head:2=0.1", "dss_head: acts on raw sensor tables"),
    ("simulate trmm_months OUT --effect dss_head=0.1", "which axis"),
]


@pytest.fixture(scope="module")
def trmm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated") / "REC"
    assert CliRunner().invoke(main, ["simulate", "trmm", str(folder), "--set", "gyro.sample_s=5.0"]).exit_code == 0
    return folder


@pytest.fixture
def refused(run_cli, trmm, tmp_path, monkeypatch):
    """Run a command that must be refused; its one line."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        if any(argument.startswith("REC") for argument in arguments):
            shutil.copytree(trmm, "REC")
        before = set(tmp_path.rglob("*"))
        result = run_cli(*arguments)
        assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
        assert "\x1b" not in result.stderr
        assert {path for path in tmp_path.rglob("*") if path.name != ".lock"} == before
        return result.stderr

    return run


@pytest.mark.parametrize(("command", "text"), WRONG, ids=[command for command, _ in WRONG])
def test_wrong_use_ends_in_one_line_and_status_2(refused, command, text):
    assert text in refused(*command.split())

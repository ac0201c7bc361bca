"""Whatever is wrong with a command, one line says it before the work, with exit status 2."""

import shutil

import pytest
from click.testing import CliRunner

from studies.cli.main import main
from tests.studies.cli.test_plan import EXTRA

WRONG = [
    # the program and its commands
    ("--nothing", "gyrocal: No such option"),
    ("nothing", "gyrocal: No such command 'nothing'."),
    ("simulat trmm OUT", "No such command 'simulat'; did you mean simulate?"),
    ("calibrate", "gyrocal calibrate: Missing argument 'RECORDING'."),
    ("calibrate REC more", "gyrocal calibrate: Got unexpected extra argument"),
    ("import csv", "gyrocal import csv: Missing argument"),
    # files to read and to write
    ("calibrate nothing", "not a folder"),
    ("calibrate \x1b[31mred", r"\x1b[31mred: not a folder"),
    ("calibrate REC --json no/such/folder/x.json", "no folder no/such/folder"),
    ("calibrate REC --json REC", "is a folder"),
    ("calibrate REC --json same --report same", "need files of their own"),
    ("calibrate REC --truth REC/recording.toml", "not a truth file"),
    ("export csv REC OUT --json none/there.json", "none/there.json: no folder none"),
    ("diagnose nothing", "not a folder"),
    ("diagnose REC --report -", "give the name of a file"),
    ("simulate trmm REC", "--force"),
    ("baseline REC/gyro.parquet", "not a TOML file"),
    ("baseline REC/recording.toml", "is not known"),
    ("baseline nowhere.toml", "nowhere.toml: no such file"),
    # scenarios, studies and effects
    ("simulate trm OUT", "trm: neither a file nor a built-in scenario; did you mean trmm"),
    ("plan REC", "REC: is a folder; a scenario is wanted here"),
    ("plan trmm --extra nosuch.toml", "nosuch.toml: no such file"),
    ("plan trmm --effect bias_orbitl", "did you mean bias_orbital"),
    ("diagnose REC --without bias_drift:z", "no such effect"),
    ("study pape", "pape: no such study; did you mean paper?"),
    ("study psi --set step_s=[1.0]", "step_s: there is no such setting; did you mean steps_s?"),
    ("study paper --set overrides.gyro.arw_deg_per_sqrt=1", "is not known; did you mean arw_deg_per_sqrt_s?"),
    ("study paper --set scenario=nothing", "nothing"),
    ("study psi --require p99(nees)<1", "the cases of this study are points of a grid"),
    ("study paper --fail-on fail", "--fail-on fail: give failed, until or require"),
    ("study paper --fail-on until", "there is no --until; give one"),
    ("study paper --limit 10m", "--limit 10m: give a time such as 30s, 10min or 2h"),
    ("study paper --cases 5 --rerun 7", "cases 0 to 4"),
    ("study consistency --cases 2 --out OUT", "more than 24 are needed"),
    # values
    ("simulate trmm OUT --set gyro.arw=1", "gyro.arw"),
    ("simulate trmm OUT --set gyro.sample_s", "PATH=VALUE"),
    *((f"simulate trmm OUT --set {name}=1e-9", name) for name in ("gyro.sample_s", "reference.every_s")),
    ("simulate trmm OUT --set orbit.altitude_km=1e300", "orbit.altitude_km"),
    ("simulate trmm OUT --set interval.0.stop_s=1e9", "interval"),
    ("calibrate REC --step 0.7", "multiple"),
    ("calibrate REC --step 1,5", "'1,5' is not a valid float"),
    ("calibrate REC --psi half", "'half' is not one of"),
    ("calibrate REC --iterations 100000000", "1<=x<=1000"),
    ("calibrate REC --max-gap nan", "longest gap"),
    ("calibrate REC --solve-for G_ab", "unknown parameter"),
    ("calibrate REC --prior-sigma-g 1e-3", "both"),
    ("calibrate REC --prior-sigma-g 1e200 --prior-sigma-bias 1", "below 1e6"),
    *((f"calibrate REC --fail-on p{text}", "give NAME<LIMIT or NAME>LIMIT") for text in ("", "<", "<x", "<nan", "<=0.1")),
    ("calibrate REC --fail-on q<1", "where NAME is p or condition"),
    ("calibrate REC --max-sigma 3", "give the saved result with --against"),
    ("calibrate REC --against REC/recording.toml", "not a result of 'gyrocal calibrate --json'"),
    *((f"calibrate REC --against a --max-sigma {text}", f"--max-sigma {text}: must be") for text in ("nan", "0", "inf")),
    *(
        (f"calibrate REC --against a --max-change {text}", message)
        for text, message in (("G_zz", "give NAME<LIMIT"), ("G_zz<-1ppm", "give NAME<LIMIT"), ("b_x<1ppm", "no unit of b_x"))
    ),
    ("calibrate REC --against a --max-change G_ab<1ppm", "unknown parameter"),
    ("predict REC --from 10 --prior-scale nan", "sigma_scale nan"),
    ("predict REC --from 10 --prior-sigma-g -1", "sigma_G -1"),
    *((f"mission OUT --days {days}", text) for days, text in (("nan", "--days nan"), ("0", "one cycle"), ("1e9", "1000 days"))),
    *((f"mission OUT --days 1 --every {every}", "must be a multiple of the cycle") for every in ("0.7", "inf", "1e308")),
    ("mission OUT --days 900 --every 0.5", "too many"),
    ("mission OUT --days 1 --json no/such/x.json", "no folder no/such"),
    ("reproduce --paper robertson --days nan", "--days nan"),
    ("reproduce --paper robertson --days 0.5", "between 1 and 200"),
    # adopted scenarios and sensors
    ("compare REC trmm trmm", "give each scenario once"),
    ("compare REC nowhere.toml", "neither a file nor a built-in scenario"),
    ("compare REC --report -", "give the name of a file"),
    ("diagnose REC --adopt -", "give the name of a file"),
    ("diagnose REC --adopt same --json same", "need files of their own"),
    ("simulate REC OUT --draw", "no posterior to draw from"),
    ("simulate trmm OUT --effect dss_head:2=0.1", "dss_head: acts on raw sensor tables"),
    ("simulate trmm_months OUT --effect dss_head=0.1", "which axis"),
    ("simulate trmm_months OUT --effect esa_bias=9", "not within"),
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = 1", "no [[interval]] sections"),
        (EXTRA.replace("title", "titel"), "titel is not known"),
        (EXTRA.replace("6000.0", "-6000.0"), "time order"),
        (EXTRA.replace('"+x"', '"+q"'), "mode"),
        ("interval = 3", "no [[interval]] sections"),
        ("[", "not a TOML file"),
    ],
)
def test_a_maneuver_that_is_none_is_refused(refused, tmp_path, text, message):
    (tmp_path / "extra.toml").write_text(text)
    assert message in refused("plan", "trmm", "--extra", "extra.toml")

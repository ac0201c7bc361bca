"""Bad words on the command line, and bad small files that options name."""

import os
from collections.abc import Iterator
from pathlib import Path

import click

from studies.cli.main import COMMAND_NAMES, main
from tests.corpus.cases import FREE, REFUSED, Bad

GOOD_ARGUMENTS = {
    ("allan",): ("REC",),
    ("baseline",): (),
    ("bench", "compare"): ("REC", "REC"),
    ("bench", "run"): ("OUT",),
    ("calibrate",): ("REC",),
    ("compare",): ("REC",),
    ("diagnose",): ("REC",),
    ("effects",): (),
    ("exam", "run"): ("001",),
    ("exam", "seal"): ("001", "--entropy", "1"),
    ("exam", "verify"): ("999",),
    ("export", "csv"): ("REC", "OUT"),
    ("import", "aem"): ("a.csv", "b.aem", "OUT"),
    ("import", "bag"): ("a.bag", "OUT"),
    ("import", "broad"): ("a.parquet", "OUT"),
    ("import", "ck"): ("a.csv", "b.bc", "c.tsc", "OUT"),
    ("import", "csv"): ("a.csv", "OUT"),
    ("import", "euroc"): ("folder", "OUT"),
    ("mission",): ("OUT", "--days", "0.01"),
    ("plan",): ("trmm",),
    ("predict",): ("REC", "--from", "100"),
    ("reproduce",): (),
    ("scenarios",): (),
    ("simulate",): ("trmm", "OUT"),
    ("study",): ("paper",),
}
NO_NUMBERS = ("", "x", "1,5", "0x10", "1e", "--", "ψ", "1\x1b[31m")
OUTPUTS = ("--json", "--report", "--figure", "--adopt", "--truth", "--out")
EFFECTS = (
    "",
    "=",
    ":",
    "bias_orbital",
    "bias_orbital:",
    "bias_orbital:z",
    "bias_orbital:z=",
    "bias_orbital:z=x",
    "bias_orbital:z=nan",
    "bias_orbital:z=inf",
    "bias_orbital:z=1e308",
    "bias_orbital:w=0.3",
    "bias_orbital=0.3",
    "bias_orbital:z=0.3,",
    "bias_orbital:z=0.3,phase",
    "bias_orbital:z=0.3,phase=",
    "bias_orbital:z=0.3,nothing=1",
    "bias_orbital:z=0.3,=1",
    "bias_orbital:z=0.3:z=1",
    "nothing:z=1",
    "noise_excess:z=-1",
    "noise_excess:z=1e300",
    "time_offset=nan",
    "time_offset=1e300",
    "time_offset:z=1",
    "g_matrix_step:z=1300,toward=w,time_s=15000",
    "g_matrix_step:z=1300",
    "g_matrix_step:z=1300,toward=y,time_s=nan",
    "g_matrix_step:z=1300,toward=y,time_s=1e308",
    "dss_head:2=0.28",
    "\x1b[31m:z=1",
    "a" * 10_000,
)
EFFECT_FILES = {
    "empty": "",
    "no syntax": "def",
    "raises": "raise RuntimeError('no\\nmore')",
    "exits": "import sys; sys.exit(3)",
    "no effect": "EFFECT = 3",
    "endless recursion": "def f(): f()\nf()",
    "effects of nothing": "EFFECTS = [None]",
    "imports nothing": "import no_such_module",
}
TRUTHS = {
    "empty": "",
    "list": "[]",
    "null": "null",
    "word": '"a"',
    "deep": "[" * 100_000,
    "deep and closed": '{"G": ' + "[" * 5_000 + "]" * 5_000 + "}",
    "long integer": '{"G": ' + "9" * 10_000 + "}",
    "huge": "[" + "0," * 1_000_000 + "0]",
    "G of words": '{"G": [["a", "b", "c"], [1, 2, 3], [1, 2, 3]], "bias_deg_s": [0, 0, 0]}',
    "G of two rows": '{"G": [[1, 0, 0], [0, 1, 0]], "bias_deg_s": [0, 0, 0]}',
    "ragged G": '{"G": [[1, 0, 0], [0, 1], [0, 0, 1]], "bias_deg_s": [0, 0, 0]}',
    "NaN": '{"G": [[NaN, 0, 0], [0, 1, 0], [0, 0, 1]], "bias_deg_s": [0, 0, 0]}',
    "infinite": '{"G": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias_deg_s": [Infinity, 0, 0]}',
    "huge number": '{"G": [[1e999, 0, 0], [0, 1, 0], [0, 0, 1]], "bias_deg_s": [0, 0, 0]}',
    "no bias": '{"G": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}',
    "bias a number": '{"G": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias_deg_s": 0}',
    "objects": '{"G": {}, "bias_deg_s": {}}',
    "not UTF-8": "\udcff",
}
SETTINGS = (
    "cases=0",
    "cases=-1",
    "cases=x",
    "cases=1e308",
    "cases=[]",
    "cases=9999999999999999999999",
    "entropy=-1",
    "entropy=x",
    "entropy=1.5",
    "sampler=x",
    "chunk=0",
    "scenario=nothing",
    "scenario=3",
    "scenario=[]",
    "overrides=3",
    "overrides.gyro.nothing=3",
    "overrides.gyro.arw_deg_per_sqrt_s=-1",
    "overrides.gyro.arw_deg_per_sqrt_s=nan",
    "overrides.gyro.arw_deg_per_sqrt_s=1e308",
    "overrides.reference.sigma_deg=1e308",
    "overrides.reference.sigma_deg=[1e308,1e308,1e308]",
    "dispersions=3",
    "dispersions.gyro.nothing={kind='normal',sigma=1}",
    "dispersions.gyro.true_G.0.0={kind='normal',sigma=1e308}",
    "dispersions.gyro.true_G.0.0={kind='normal',sigma=-1}",
    "dispersions.gyro.true_G.0.0={kind='normal',sigma=nan}",
    "dispersions.gyro.true_G.0.0={kind='nothing',sigma=1}",
    "dispersions.gyro.true_G.0.0={kind='uniform',low=1,high=0}",
    "dispersions.gyro.true_G.9.9={kind='normal',sigma=1}",
    "steps_s=[]",
    "steps_s=[nan]",
    "steps_s=[-1]",
    "steps_s=[1e308]",
    "steps_s=0.5",
    "=",
    "cases",
    "a.b.c=1",
    "cases.x=1",
    "=1",
)


def commands() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command by its words."""
    context = click.Context(main)
    for name in COMMAND_NAMES:
        command = main.get_command(context, name)
        if isinstance(command, click.Group):
            yield from (((name, key), one) for key, one in command.commands.items())
        elif command is not None:
            yield (name,), command


def options() -> Iterator[Bad]:
    """Each option of each command with what it cannot have, and commands with too little or too much."""
    for words, command in commands():
        arguments = GOOD_ARGUMENTS[words]
        label = " ".join(words)
        yield Bad("usage", f"{label}: unknown option", (*words, *arguments, "--nothing"))
        yield Bad(
            "usage",
            f"{label}: too many arguments",
            (*words, *arguments, *("a", "b", "c", "d")) if arguments else (*words, "a", "b"),
        )
        if any(isinstance(one, click.Argument) and one.required for one in command.params):
            yield Bad("usage", f"{label}: no arguments", words)
        for option in command.params:
            if not isinstance(option, click.Option) or option.is_flag:
                continue
            flag = option.opts[0]
            given = (*words, *arguments, flag)
            yield Bad("usage", f"{label} {flag}: no value", given)
            if isinstance(option.type, click.types.FloatParamType | click.types.IntParamType):
                for word in NO_NUMBERS:
                    yield Bad("option", f"{label} {flag} {word!a}", (*given, word))
            if isinstance(option.type, click.IntRange):
                for word in ("-1", "1.5", "1e3", "nan"):
                    yield Bad("option", f"{label} {flag} {word}", (*given, word))
            if isinstance(option.type, click.Choice):
                yield Bad("option", f"{label} {flag} nothing", (*given, "nothing"))


def numbers() -> Iterator[Bad]:
    """Numbers that no option can have, to commands that would compute with them."""
    wrong = ("nan", "inf", "-inf", "-1", "0", "1e308", "1e-308")
    for flag in ("--step", "--max-gap", "--plausible-g", "--plausible-bias"):
        for word in wrong:
            yield Bad("number", f"calibrate {flag} {word}", ("calibrate", "REC", flag, word), expected=FREE)
    for word in wrong:
        both = ("--prior-sigma-g", word, "--prior-sigma-bias", word)
        yield Bad("number", f"calibrate --prior-sigma {word}", ("calibrate", "REC", *both))
        yield Bad("number", f"mission --days {word}", ("mission", "OUT", "--days", word))
        yield Bad("number", f"mission --every {word}", ("mission", "OUT", "--days", "0.01", "--every", word))
        yield Bad("number", f"reproduce --days {word}", ("reproduce", "--paper", "robertson", "--out", "OUT", "--days", word))
        yield Bad("number", f"predict --from {word}", ("predict", "REC", "--from", word), expected=FREE)
        expected = FREE if float(word) in (0, 1e-308) else REFUSED
        for flag in ("--prior-sigma-g", "--prior-sigma-bias", "--prior-mounting", "--prior-scale"):
            given = ("predict", "REC", "--from", "1000", flag, word)
            yield Bad("number", f"predict {flag} {word}", given, expected=expected)
    yield Bad("number", "calibrate --iterations 100000000", ("calibrate", "REC", "--iterations", "100000000"))
    for word in (
        "",
        "x",
        "all,",
        "-all",
        "G_xx,G_xx",
        "bias,-bias",
        "gyro_w",
        "\x1b[31m",
        "s_x",
        "all,-G_ab",
        ",".join(["all"] * 3000),
    ):
        yield Bad("number", f"calibrate --solve-for {word[:20]!a}", ("calibrate", "REC", f"--solve-for={word}"), expected=FREE)


def effects() -> Iterator[Bad]:
    """Effects that are none."""
    coarse = ("--set", "gyro.sample_s=5.0")
    for text in EFFECTS:
        yield Bad("effect", text[:40].encode("unicode_escape").decode(), ("simulate", "trmm", "OUT", *coarse, "--effect", text))
        yield Bad(
            "effect",
            f"mission {text[:40].encode('unicode_escape').decode()}",
            ("mission", "OUT", "--days", "0.01", "--effect", text),
        )
    for kind, text in EFFECT_FILES.items():
        yield Bad(
            "effect file", kind, ("effects", "--effects", "mine.py"), lambda folder, text=text: _write(folder / "mine.py", text)
        )
    for name in ("nothing.py", "REC", "/dev/null", "REC/gyro.parquet"):
        yield Bad("effect file", name, ("effects", "--effects", name))
    for name in ("nothing", "", "\x1b"):
        yield Bad("effect", f"--without {name!a}", ("diagnose", "REC", "--without", name))
        yield Bad("effect", f"plan --effect {name!a}", ("plan", "trmm", "--effect", name))


def small_files() -> Iterator[Bad]:
    """Truths, and settings of studies."""
    for kind, text in TRUTHS.items():
        given = ("calibrate", "REC", "--truth", "truth.json")
        yield Bad("truth", kind, given, lambda folder, text=text: _write(folder / "truth.json", text))
    for kind in ("nothing", "REC", "/dev/null", "/dev/zero"):
        yield Bad("truth", kind, ("calibrate", "REC", "--truth", kind))
        yield Bad("calibration", kind, ("predict", "REC", "--from", "100", "--calibration", kind))
    for kind, text in TRUTHS.items():
        given = ("predict", "REC", "--from", "100", "--calibration", "truth.json")
        yield Bad("calibration", kind, given, lambda folder, text=text: _write(folder / "truth.json", text))
    study = ("study", "paper", "--backend", "serial", "--out", "OUT", "--cases", "2", "--set", "overrides.gyro.sample_s=5.0")
    for text in SETTINGS:
        steps = () if text.startswith("steps") else ("--set", "steps_s=[5.0]")
        given = [one for one in study if not (text.startswith("cases=") and one in ("--cases", "2"))]
        yield Bad("study setting", text, (*given, *steps, "--set", text))
    for kind, text in {
        "empty": "",
        "no JSON": "{",
        "a list": "[]",
        "no runs": '{"config_sha256": "", "chunk": 1}',
        "runs of words": '{"config_sha256": "", "chunk": 1, "runs": ["a"]}',
    }.items():
        yield Bad("manifest", kind, (*study, "--set", "steps_s=[5.0]"), lambda folder, text=text: _manifest(folder, text))
    deep = "[" * 100_000
    yield Bad("manifest", "deep", (*study, "--set", "steps_s=[5.0]"), lambda folder: _manifest(folder, deep))
    for name in ("consistency",):
        for cases in ("1", "2", "24"):
            given = ("study", name, "--backend", "serial", "--out", "OUT", "--cases", cases)
            yield Bad("study", f"{name} --cases {cases}", given)


def outputs() -> Iterator[Bad]:
    """Files and folders that cannot be written."""
    for words, command in commands():
        for option in command.params:
            flag = option.opts[0]
            if flag not in OUTPUTS or (words in (("study",), ("reproduce",)) and flag == "--out"):
                continue
            if words in (("calibrate",),) and flag == "--truth":
                continue
            given = (*words, *GOOD_ARGUMENTS[words], flag)
            for kind in ("REC", "nothing/a.json", "REC/recording.toml/a.json", "link.json", "dangling.json", ""):
                yield Bad("output", f"{' '.join(words)} {flag} {kind!a}", (*given, kind), _links)
    for command in ("allan", "calibrate"):
        yield Bad("output", f"{command} --json /dev/full", (command, "REC", "--json", "/dev/full"))
    yield Bad("output", "effects --json /dev/full", ("effects", "--json", "/dev/full"))
    for words in (("simulate", "trmm"), ("mission", "--days", "0.01")):
        for kind in ("REC", "REC/recording.toml", "REC/recording.toml/OUT", "dangling.json", "link.json"):
            if (words[0], kind) == ("mission", "REC"):
                continue  # the tables of a mission may lie beside a recording
            yield Bad("output", f"{words[0]} {kind}", (*words, kind), _links)


def imports() -> Iterator[Bad]:
    """Tables of others, and mappings that do not fit them."""
    given = ("import", "csv", "a.csv", "OUT")
    words = {
        "--time": ("", "t", "t:", ":s", "t:fortnights", "x:s", "t:s:s", "\x1b:s"),
        "--gyro": (
            "",
            "gx",
            "gx:deg/s",
            "gx,gy,gz",
            "gx,gy,gz:",
            "gx,gy,gz:furlongs",
            "gx,gx,gx:deg/s",
            "a,b,c:deg/s",
            "-:deg/s",
            "#90,#91,#92:deg/s",
            "#0,1,2:deg/s",
        ),
        "--quat": ("", "q1", "q1,q2,q3,q4", "q1,q2,q3,q4:sideways", "a,b,c,d:body-to-inertial", "q1,q2,q3:body-to-inertial"),
        "--euler": ("", "a,b,c:deg:XYZ", "gx,gy,gz:deg:QQQ:body-to-inertial", "gx,gy,gz:deg:XXZ:body-to-inertial"),
        "--matrix": ("", "q1:body-to-inertial"),
        "--lsb": ("", "x", "0 deg/s", "nan deg/s", "-1 deg/s"),
        "--wrap": ("0", "-1", "nan", "inf"),
        "--interval": ("0", "-1", "nan", "1e-308"),
        "--spacing": ("0", "-1", "nan", "1e308"),
        "--attitude-offset": ("nan", "inf", "1e308"),
    }
    right = {"--time": "t:s", "--gyro": "gx,gy,gz:deg/s", "--quat": "q1,q2,q3,q4:body-to-inertial:scalar-last"}
    for flag, wrong in words.items():
        for word in wrong:
            others = {**right, flag: word} if flag not in ("--euler", "--matrix") else {**right, flag: word, "--quat": None}
            flags = [f"{name}={value}" for name, value in others.items() if value is not None]
            yield Bad("import csv", f"{flag} {word!a}", (*given, *flags), _table)
    flags = [f"{name}={value}" for name, value in right.items()]
    edits = {
        "empty": "",
        "a header": "t,gx,gy,gz,q1,q2,q3,q4\n",
        "one row": "t,gx,gy,gz,q1,q2,q3,q4\n0,0,0,0,0,0,0,1\n",
        "words": "t,gx,gy,gz,q1,q2,q3,q4\n" + "a,b,c,d,e,f,g,h\n" * 20,
        "all the same": "t,gx,gy,gz,q1,q2,q3,q4\n" + "0,0,0,0,0,0,0,1\n" * 20,
        "binary": "\x00\x01\x02" * 100,
        "infinite": "t,gx,gy,gz,q1,q2,q3,q4\n" + "".join(f"{k},inf,0,0,0,0,0,1\n" for k in range(20)),
        "huge": "t,gx,gy,gz,q1,q2,q3,q4\n" + "".join(f"{k},1e300,0,0,0,0,0,1\n" for k in range(20)),
        "zero quaternions": "t,gx,gy,gz,q1,q2,q3,q4\n" + "".join(f"{k},0,0,0,0,0,0,0\n" for k in range(20)),
        "extra fields": "t,gx,gy,gz,q1,q2,q3,q4\n" + "".join(f"{k},0,0,0,0,0,0,1,9\n" for k in range(20)),
    }
    for kind, text in edits.items():
        yield Bad("import csv", kind, (*given, *flags), lambda folder, text=text: _write(folder / "a.csv", text))
    yield Bad("import csv", "no file", (*given, *flags))
    messages = {
        "empty": "",
        "a word": "CCSDS",
        "version": "CCSDS_AEM_VERS = 9.0\n",
        "no data": "CCSDS_AEM_VERS = 2.0\n",
        "NUL": "\x00",
    }
    for kind, text in messages.items():

        def damage(folder: Path, text: str = text) -> None:
            _table(folder)
            _write(folder / "b.aem", text)

        yield Bad("import aem", kind, ("import", "aem", "a.csv", "b.aem", "OUT", "--time=t:s", "--gyro=gx,gy,gz:deg/s"), damage)
    for folder_name in ("nothing", "REC", "REC/recording.toml"):
        yield Bad("import euroc", folder_name, ("import", "euroc", folder_name, "OUT"))
        yield Bad("import broad", folder_name, ("import", "broad", folder_name, "OUT"))


def _write(path: Path, text: str) -> None:
    path.write_bytes(text.encode("utf-8", "surrogateescape"))


def _links(folder: Path) -> None:
    (folder / "link.json").symlink_to("REC/recording.toml")
    (folder / "dangling.json").symlink_to("REC/nothing")


def _manifest(folder: Path, text: str) -> None:
    os.mkdir(folder / "OUT")
    _write(folder / "OUT" / "manifest.json", text)


def _table(folder: Path) -> None:
    """Twenty seconds of a turn about z at one deg/s, as another program writes it."""
    import numpy as np

    half = np.deg2rad(np.arange(20.0)) / 2
    rows = [f"{k},0,0,1,0,0,{np.sin(h)},{np.cos(h)}" for k, h in enumerate(half)]
    _write(folder / "a.csv", "\n".join(["t,gx,gy,gz,q1,q2,q3,q4", *rows, ""]))

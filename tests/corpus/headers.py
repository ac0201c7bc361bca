"""Bad documents: recording.toml, and scenarios, with each of their values replaced, left out or made something else."""

import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from gyrocal.recording import format_toml
from simulator import scenario as scenarios
from tests.corpus.cases import FREE, JUDGED, Bad

VALUES = {
    "text": '"a word"',
    "empty text": '""',
    "list": "[]",
    "table": "{ a = 1 }",
    "true": "true",
    "nan": "nan",
    "infinite": "inf",
    "negative": "-1.0",
    "zero": "0.0",
    "huge": "1e308",
    "tiny": "1e-308",
    "long integer": "9" * 400,
    "date": "1979-05-27",
    "escape": '"\\u001b[31mred"',
}
WHOLE = {
    "empty": b"",
    "binary": bytes(range(256)),
    "UTF-16": "format = 1".encode("utf-16"),
    "open string": b'title = "a',
    "deep list": b"format = " + b"[" * 5000,
    "deep table": b"format = " + b"{a = " * 2000,
    "many digits": b"format = " + b"1" * 5000,
    "twice": b"format = 1\nformat = 1\n",
    "NUL": b"format = 1\n\x00\n",
    "JSON": b'{"format": 1}',
}


def leaves(document: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the values of a document are, of alike items of a list the first."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from leaves(value, (*path, key))
    elif isinstance(document, list) and document and isinstance(document[0], dict):
        yield from leaves(document[0], (*path, 0))
    else:
        yield path


def text_of(document: Any, prefix: str = "") -> str:
    """TOML of a document whose values may be texts of TOML already."""
    plain = [f"{key} = {_value(value)}" for key, value in document.items() if not _sections(value)]
    lines = [*plain]
    for key, value in document.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            lines += [f"[{name}]", text_of(value, f"{name}.")]
        elif _sections(value):
            for one in value:
                lines += [f"[[{name}]]", text_of(one, f"{name}.")]
    return "\n".join(lines) + "\n"


class Raw(str):
    """A value as it is to stand in the file."""


def _value(value: Any) -> str:
    return str(value) if isinstance(value, Raw) else format_toml(value)


def _sections(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def changed(text: str, path: tuple[Any, ...], value: str | None) -> str:
    """A document with one value replaced by a piece of TOML, or left out."""
    document = tomllib.loads(text)
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = Raw(value)
    return text_of(document)


def write(folder: Path, name: str, path: tuple[Any, ...], value: str | None) -> None:
    """Change one value of a file of TOML."""
    file = folder / name
    file.write_text(changed(file.read_text(), path, value))


def recordings() -> Iterator[Bad]:
    """Of recording.toml."""
    calibrate = ("calibrate", "REC")
    header = {
        "format": 1,
        "title": "a",
        "epoch": "2000-01-01",
        "time_scale": "UTC",
        "gyro": dict.fromkeys(("sample_s", "kind", "arw_deg_per_sqrt_s", "apriori_G", "apriori_bias_deg_s")),
        "attitude": dict.fromkeys(("maps", "quaternion")),
        "orbit": dict.fromkeys(("period_s", "altitude_km", "inclination_deg")),
        "interval": [dict.fromkeys(("name", "activity", "start_s", "stop_s"))],
    }
    for path in leaves(header):
        for kind, value in {**VALUES, "left out": None}.items():
            damage = partial(write, name="REC/recording.toml", path=path, value=value)
            yield Bad("recording.toml", f"{'.'.join(map(str, path))}: {kind}", calibrate, damage, JUDGED)
    for kind, data in WHOLE.items():
        yield Bad(
            "recording.toml", kind, calibrate, lambda folder, data=data: (folder / "REC/recording.toml").write_bytes(data)
        )
    unknown = partial(write, name="REC/recording.toml", path=("gyro", "wheels"), value="4")
    yield Bad("recording.toml", "unknown key", calibrate, unknown)


def scenario_files() -> Iterator[Bad]:
    """Of a scenario, simulated."""
    text = scenarios.read_text("trmm")
    simulate = ("simulate", "mine.toml", "OUT", "--set", "gyro.sample_s=5.0")
    for path in leaves(tomllib.loads(text)):
        for kind, value in {**VALUES, "left out": None}.items():
            if path == ("gyro", "sample_s"):
                continue

            def damage(folder: Path, path: tuple[Any, ...] = path, value: str | None = value) -> None:
                (folder / "mine.toml").write_text(changed(text, path, value))

            yield Bad("scenario", f"{'.'.join(map(str, path))}: {kind}", simulate, damage, FREE)
    for kind, data in WHOLE.items():
        yield Bad("scenario", kind, simulate, lambda folder, data=data: (folder / "mine.toml").write_bytes(data))
    yield Bad("scenario", "chain of bases", ("simulate", "base-0.toml", "OUT"), _chain)
    yield Bad("scenario", "base of itself", simulate, lambda folder: (folder / "mine.toml").write_text('base = "mine.toml"'))
    for kind in ("REC", "nothing.toml", "", "/dev/null", "a\x1b[31m.toml", "tram"):
        yield Bad("scenario", f"name {kind!a}", ("simulate", kind, "OUT") if kind != "REC" else ("plan", "REC"))


def _chain(folder: Path) -> None:
    for number in range(1500):
        (folder / f"base-{number}.toml").write_text(f'base = "base-{number + 1}.toml"\n')
    (folder / "base-1500.toml").write_text('base = "trmm"\n')

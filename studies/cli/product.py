"""The command ``gyrocal product``: a calibration as the table that a mission uploads."""

import hashlib
from pathlib import Path
from typing import Any

import click

from gyrocal.errors import InputError
from studies.cli.options import PATH, add_output_option, read_json

RESULT = "a result of gyrocal calibrate --json with provenance"


@click.command("product")
@click.argument("calibration", type=PATH)
@click.option(
    "--old",
    type=PATH,
    metavar="OLD.json",
    help="Table in use: another result, or JSON with G and bias_deg_s; the values that CALIBRATION started from by default.",
)
@click.option("--template", type=PATH, help="Jinja template of your own; docs/product.md lists the variables.")
@add_output_option("--out", help="Write the product to this file; standard output by default.")
def command(calibration: Path, old: Path | None, template: Path | None, out: Path | None) -> None:
    """Fill a template with CALIBRATION beside the old values: units, changes in sigma, validity and provenance.

    CALIBRATION is a result of gyrocal calibrate --json. See docs/product.md.

    \b
    Example:
      gyrocal simulate trmm /tmp/rec --truth /tmp/truth.json
      gyrocal calibrate /tmp/rec --json /tmp/result.json
      gyrocal product /tmp/result.json --out /tmp/product.txt
      gyrocal product /tmp/result.json --old /tmp/truth.json
    """
    from studies.montecarlo.files import write_text
    from studies.report.product import build_product, read_default_template, read_parameter_table, render_product

    def check_old(document: Any) -> Any:
        read_parameter_table(dict(document))
        return document

    before = None if old is None else read_json(old, "a table with G and bias_deg_s", check_old)
    values = read_json(calibration, RESULT, lambda document: build_product(dict(document), before))
    values["provenance"] |= {
        "calibration": calibration.name,
        "calibration_sha256": _hash_file(calibration),
        "old": "values before the calibration" if old is None else old.name,
        "old_sha256": None if old is None else _hash_file(old),
    }
    name = "the template" if template is None else str(template)
    text = render_product(read_default_template() if template is None else _read_template(template), values, name)
    if out:
        write_text(out, text)
    else:
        click.echo(text, nl=False)


def _hash_file(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _read_template(path: Path) -> str:
    """A template; a device or a pipe is none."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a file; give a template")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as fault:
        raise InputError(f"{path}: not UTF-8: {fault}") from None

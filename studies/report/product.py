"""Fill the template of a calibration product: the new table beside the old one, with its validity and provenance."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from importlib import metadata, resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal import NAMES
from gyrocal.calibration.remainder_processes import WITH_REMAINDER
from gyrocal.errors import InputError

Array = NDArray[np.float64]

DEFAULT_TEMPLATE = "product.txt"
PRODUCT_PAGE = "docs/product.md"  # of the variables
COMPILED_TEMPLATE_FILE = "<template>"  # Jinja's name for one that is no file, in tracebacks


def read_parameter_table(document: Mapping[str, Any]) -> tuple[Array, Array]:
    """Read G and b (12,), deg/s, and their recommended sigmas, which are zero where a document states none.

    Raises
    ------
    ValueError, KeyError, TypeError
        They are no such numbers.
    """
    values = np.append(np.array(document["G"], dtype=float).ravel(), np.array(document["bias_deg_s"], dtype=float))
    kind = "with_remainder" if document.get("recommended") == WITH_REMAINDER else "nominal"
    sigma = np.array(document.get(f"sigma_{kind}", np.zeros(12)), dtype=float)
    if values.shape != (12,) or sigma.shape != (12,) or not np.isfinite([values, sigma]).all():
        raise ValueError("G, bias_deg_s and sigmas must be 3×3, 3 and 12 finite numbers")
    return values, sigma


def build_product(document: Mapping[str, Any], old: Mapping[str, Any] | None) -> dict[str, Any]:
    """Build the variables of a template.

    Parameters
    ----------
    document : of `gyrocal calibrate --json`
    old : another one, or any with G and bias_deg_s; the values that the calibration started from by default
    """
    new, sigma = read_parameter_table(document)
    before, old_sigma = read_parameter_table(document["initial"] if old is None else old)
    both = np.hypot(sigma, old_sigma)
    rows = [
        {
            "name": name,
            "kind": "bias" if k >= 9 else "scale factor" if k % 4 == 0 else "misalignment",
            "unit": "deg/s" if k >= 9 else "1",
            "old": float(before[k]),
            "old_sigma": float(old_sigma[k]),
            "new": float(new[k]),
            "sigma": float(sigma[k]),
            "change": float(new[k] - before[k]),
            "change_in_sigma": float((new[k] - before[k]) / both[k]) if both[k] > 0 else None,
            "calibrated": name in document["parameters"],
        }
        for k, name in enumerate(NAMES)
    ]
    made = document["provenance"]
    return {
        "recording": document["recording"],
        "rows": rows,
        "valid_from": made["valid_from"],
        "valid_until": made["valid_until"],
        "time_scale": made["time_scale"],
        "p_value": document["p_value"],
        "sigma_kind": document["recommended"],
        "warnings": document["warnings"],
        "provenance": {
            "recording_sha256": made["recording_sha256"],
            "version": document["version"],
            "commit": made["commit"],
            "options": document["options"],
            "product_version": metadata.version("gyrocal"),
        },
    }


def read_default_template() -> str:
    """Read the template that the package has."""
    return resources.files("studies.report").joinpath("templates", DEFAULT_TEMPLATE).read_text(encoding="utf-8")


def render_product(template: str, values: Mapping[str, Any], name: str) -> str:
    """Fill a template.

    Raises
    ------
    InputError
        The template cannot be filled; the message has the line.
    """
    import jinja2
    from jinja2.sandbox import SandboxedEnvironment  # a template may come from elsewhere

    environment = SandboxedEnvironment(
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    try:
        return environment.from_string(template).render(values)
    except jinja2.TemplateSyntaxError as fault:
        line, message = fault.lineno, fault.message
    except Exception as fault:  # of the template's own expressions: they raise what Python raises
        frames = traceback.extract_tb(fault.__traceback__)
        line = next((one.lineno or 1 for one in reversed(frames) if one.filename == COMPILED_TEMPLATE_FILE), 1)
        message = str(fault)
    raise InputError(f"{name}, line {line}: {' '.join(str(message).split())}; {PRODUCT_PAGE} lists the variables")

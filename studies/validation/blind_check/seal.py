"""Seals: SHA-256 of a salt and an answer, published before anybody may know the answer.

The salt keeps a guessed answer from being tested against its seal; the canonical form (sorted keys, no blanks, shortest
digits that read back the same number) makes the seal that of the content, not of the file.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from typing import Any

from gyrocal.errors import InputError

SALT_BYTES = 32


def canonical(answer: Mapping[str, Any]) -> str:
    """An answer as the one JSON text that stands for it."""
    return json.dumps(answer, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def new_salt() -> str:
    """A salt that nobody can foresee, hexadecimal; not from the case's own streams, whose entropy is no secret."""
    return secrets.token_hex(SALT_BYTES)


def seal(answer: Mapping[str, Any], salt: str) -> str:
    """SHA-256 of salt and canonical answer, hexadecimal."""
    return hashlib.sha256(f"{salt}\n{canonical(answer)}".encode()).hexdigest()


def check(seals: Mapping[str, str], sealed: Mapping[str, Mapping[str, Any]]) -> None:
    """Check every answer against its seal.

    Parameters
    ----------
    seals : by case, as published
    sealed : by case, each with salt and answer

    Raises
    ------
    InputError
        An answer has changed, is missing, or was never sealed.
    """
    odd = sorted(set(seals) ^ set(sealed))
    if odd:
        raise InputError(f"case {odd[0]}: {'no answer to its seal' if odd[0] in seals else 'an answer without a seal'}")
    for case, one in sealed.items():
        if seal(one["answer"], one["salt"]) != seals[case]:
            raise InputError(f"case {case}: the answer is not the one that was sealed")

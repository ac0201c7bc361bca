"""The faults of a document in words: pydantic's messages as a person would say them, with what may have been meant."""

import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from gyrocal.errors import suggest_names

# In this order; the rest of a message stays as it is.
MESSAGE_REPLACEMENTS = (
    (r"^(Value|Assertion) error, ", ""),
    (r"^Extra inputs are not permitted$", "is not known"),
    (r"^Field required$", "is missing"),
    (r"^Input should be ", "must be "),
    (r"^Unable to extract tag using discriminator '(\w+)'$", r"\1 is missing"),
    (r"^Input tag '(.*)' found using '(\w+)' does not match any of the expected tags: (.*)$", r"\2 is '\1', not one of \3"),
    (r"^(?:List|Tuple|Dictionary|String) should have (at (?:least|most) \d+) (\w+).*$", r"must have \1 \2"),
    (r"(a valid \w+), .*$", r"\1"),
    (r"a valid dictionary(?: or (?:object|instance).*)?$", "a table"),
    (r"a valid (?:list|tuple)$", "a list"),
    (r"a valid string$", "text"),
    (r"a valid integer$", "a whole number"),
    (r"a valid boolean$", "true or false"),
    (r"a valid number$", "a number"),
)
UNKNOWN = "extra_forbidden"


def format_validation_error(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """All faults of a validated document in one line, each by its path.

    Parameters
    ----------
    error : of the validation
    model : what the document should have been; for a key that there is not, its keys are told
    """
    return "; ".join(_format_fault(one, model) for one in error.errors(include_url=False))


def _format_fault(fault: Any, model: type[BaseModel] | None) -> str:
    text = str(fault["msg"])
    for pattern, words in MESSAGE_REPLACEMENTS:
        text = re.sub(pattern, words, text)
    if fault["type"] == UNKNOWN and model is not None:
        known = _list_keys(model, fault["loc"][:-1])
        text += f"; {suggest_names(str(fault['loc'][-1]), known)}" if known else ""
    return f"{'.'.join(str(part) for part in fault['loc']) or 'document'}: {text}"


def _list_keys(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Keys of the table at a path of a document; none where that is not known."""
    here: list[type[BaseModel]] = [model]
    for part in path:
        if isinstance(part, int):
            continue  # an item of a list is what the list holds
        tagged = [kind for kind in here if _has_tag(kind, part)]
        inside = [found for kind in here if part in kind.model_fields for found in _list_models(kind.model_fields[part])]
        here = inside or tagged or here
    return list(dict.fromkeys(key for kind in here for key in kind.model_fields))


def _has_tag(kind: type[BaseModel], tag: str) -> bool:
    """Whether a model is the one of a union that this tag stands for."""
    return any(tag in get_args(field.annotation) for field in kind.model_fields.values())


def _list_models(field: Any) -> Iterator[type[BaseModel]]:
    """The models in the type of a field, or a part of a type."""
    kind = getattr(field, "annotation", field)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for inner in (*get_args(kind), *getattr(kind, "__metadata__", ())):
        yield from _list_models(inner)

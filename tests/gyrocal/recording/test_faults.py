from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gyrocal.errors import suggest_names
from gyrocal.recording import format_validation_error


class Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    length_s: float = Field(default=1.0, gt=0)
    kind: Literal["round"] = "round"


class Other(BaseModel):
    model_config = ConfigDict(extra="forbid")

    kind: Literal["square"]
    width: int = 1


class Whole(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str
    parts: list[Part] = Field(default=[], max_length=2)
    either: dict[str, Annotated[Part | Other, Field(discriminator="kind")]] = {}
    maybe: Part | None = None
    on: bool = False
    count: int = 0

    @field_validator("count")
    @classmethod
    def _even(cls, value: int) -> int:
        if value % 2:
            raise ValueError("must be even")
        return value


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({}, "name: is missing"),
        ({"name": 3}, "name: must be text"),
        ({"name": "a", "nam": 1}, "nam: is not known; did you mean name?"),
        ({"name": "a", "xyz": 1}, "xyz: is not known; there are name, parts, either, maybe, on, count"),
        ({"name": "a", "parts": [{"length": 1.0}]}, "parts.0.length: is not known; did you mean length_s?"),
        ({"name": "a", "parts": [{"length_s": 0.0}]}, "parts.0.length_s: must be greater than 0"),
        ({"name": "a", "parts": [{}, {}, {}]}, "parts: must have at most 2 items"),
        ({"name": "a", "parts": [{"kind": "r"}]}, "parts.0.kind: must be 'round'"),
        ({"name": "a", "either": {"x": {"kind": "oval"}}}, "either.x: kind is 'oval', not one of 'round', 'square'"),
        ({"name": "a", "either": {"x": {"kind": "square", "widht": 1}}}, "widht: is not known; did you mean width?"),
        ({"name": "a", "count": 3}, "count: must be even"),
    ],
)
def test_faults_are_said_in_words(document, message):
    with pytest.raises(ValidationError) as caught:
        Whole.model_validate(document)
    said = format_validation_error(caught.value, Whole)
    assert said == message or said.endswith(message)
    assert not any(word in said for word in ("Input", "Extra", "Value error", "valid ", "Field", "discriminator"))


def test_hints():
    assert suggest_names("trm", ["trmm", "trmm2", "other"]) == "did you mean trmm or trmm2?"
    assert suggest_names("q", ["trmm", "other"]) == "there are trmm, other"

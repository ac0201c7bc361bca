"""One stretch of a recording that was not measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class MaskedStretch:
    """One stretch of a recording that was not measured."""

    what: str  # "clipped" or "stopped" gyro, "frozen" references, "reference jump", or "excluded" by hand
    axis: str | None  # of the gyro, or that about which the references jump most; None for all
    from_s: float  # from_s, to_s: s since the epoch; equal where the references jump and stay
    to_s: float
    size: float = 0.0  # level of a gyro, deg/s, or angle of a jump, deg

    @property
    def key(self) -> tuple[str, str | None, float]:
        """What is said in one sentence: the kind, the gyro, and the side on which it is clipped."""
        if self.what == "reference jump":
            return self.what, None, 0.0
        return self.what, self.axis, float(np.sign(self.size)) if self.what == "clipped" else 0.0

    def describe_kind(self, sizes: Sequence[float]) -> str:
        """Say what stretches of this kind are, and how large they are."""
        gyro = f"gyro {self.axis}" if self.axis else "every gyro"
        if self.what == "reference jump":
            spread = f"{min(sizes):.2g} to {max(sizes):.2g}" if len(sizes) > 1 else f"{sizes[0]:.2g}"
            return f"the references jump {len(sizes)} time(s) by {spread} deg, which the gyro does not confirm"
        level = f"{float(np.median(sizes)):.4g} deg/s"
        return {
            "clipped": f"{gyro} is clipped at {level}",
            "stopped": f"{gyro} stops at {level} while the references turn",
            "frozen": "the references repeat one attitude while the gyro turns",
            "excluded": "excluded by hand",
        }[self.what]

    def to_json(self) -> dict[str, Any]:
        """The stretch as documented."""
        return {"what": self.what, "axis": self.axis, "from_s": self.from_s, "to_s": self.to_s, "size": self.size}

"""Effects of several angles, whose size is their norm."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, Parameter, Setting, Value


@dataclass(frozen=True)
class DirectedEffect(Effect):
    """An effect of several angles: its size is their norm, its parameters say the direction and may have any length."""

    @property
    def directions(self) -> tuple[Parameter, ...]:
        """The parameters that are angles; all but words."""
        return tuple(one for one in self.parameters if not one.choices)

    def amplitudes(self, setting: Setting) -> Array:
        """The angles, in the effect's unit."""
        direction = np.array([float(setting.parameters[one.name]) for one in self.directions])
        length = np.linalg.norm(direction)
        return np.asarray(setting.size * direction / length) if length > 0 else np.zeros(direction.size)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """The norm, and the angles."""
        named = {one.name: float(value) for one, value in zip(self.directions, amplitudes, strict=True)}
        return float(np.linalg.norm(amplitudes)), dict(named)

    def completed(self, setting: Setting) -> Setting:
        """Complete a setting: replace the direction by the angles."""
        size, angles = self.from_amplitudes(self.amplitudes(setting))
        if size == 0:
            raise InputError(f"{setting.label()}: {', '.join(angles)} are all zero, and it would do nothing; one must not be")
        others: Mapping[str, Value] = {name: value for name, value in setting.parameters.items() if name not in angles}
        return replace(setting, size=size, parameters={**others, **angles})

"""All effects by name: the built-in ones, those of installed plug-ins, and those of a file.

A plug-in is a package with an entry point in the group `gyrocal.effects`: an `Effect`, a list of them, or a module with
`EFFECT` or `EFFECTS`. Plug-ins are loaded when the whole registry, or a name that is not built in, is asked for the first time.

    [project.entry-points."gyrocal.effects"]
    bias_battery = "my_package.bias_battery"
"""

import importlib.util
import warnings
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TypeGuard, TypeVar

from gyrocal.errors import InputError
from simulator.effects.base import STAGE_NAMES, STAGES, SYMPTOMS, Effect

ENTRY_POINT_GROUP = "gyrocal.effects"
FILE_MODULE = "gyrocal_effects_"  # begins the names of modules that are loaded from files

Kind = TypeVar("Kind", bound=Effect)


class Registry(Mapping[str, Effect]):
    """Effects by name, in the order in which they were registered."""

    def __init__(self) -> None:
        self.effects: dict[str, Effect] = {}
        self._plugins_loaded = False

    def __getitem__(self, name: str) -> Effect:
        if name not in self.effects:
            self.load_plugins()
        return self.effects[name]

    def __iter__(self) -> Iterator[str]:
        self.load_plugins()
        return iter(self.effects)

    def __len__(self) -> int:
        self.load_plugins()
        return len(self.effects)

    def register(self, effect: Effect) -> None:
        """Add an effect; an `InputError` says what about it cannot work."""
        name = effect.name
        if name in self.effects:
            raise InputError(f"{name}: there is an effect of that name already")
        if effect.stage not in STAGE_NAMES:
            raise InputError(f"{name}: no stage '{effect.stage}' in the measuring chain; there are {', '.join(STAGE_NAMES)}")
        calls = next(stage.calls for stage in STAGES if stage.name == effect.stage)
        if not effect.implements(calls):
            raise InputError(f"{name}: stage {effect.stage} calls its method {calls}, which it does not have")
        if effect.symptom is not None and effect.symptom not in SYMPTOMS:
            raise InputError(f"{name}: no symptom '{effect.symptom}'; there are {', '.join(SYMPTOMS)}")
        if not 0 < effect.prior[0] < effect.prior[1]:
            raise InputError(f"{name}: prior must be two sizes above zero, the smaller one first")
        parameters = {parameter.name for parameter in effect.parameters}
        if effect.switched and "time_s" not in parameters:
            raise InputError(f"{name}: is switched on at a time, and needs a parameter time_s")
        if effect.scanned and "period_s" not in parameters:
            raise InputError(f"{name}: its period is scanned for, and needs a parameter period_s")
        self.effects[name] = effect

    def remove(self, name: str) -> None:
        """Take an effect out again."""
        del self.effects[name]

    def load_plugins(self) -> None:
        """Register the effects of installed plug-ins, once; one that is broken is left out with a warning that names it."""
        if self._plugins_loaded:
            return
        self._plugins_loaded = True
        for point in entry_points(group=ENTRY_POINT_GROUP):
            try:
                self.register_all(collect_effects(point.load()))
            except Exception as fault:  # a plug-in may fail in any way, and its traceback would not say whose fault it is
                warnings.warn(
                    f"effect plug-in {point.name} ({point.value}) is left out: {_format_exception(fault)}", stacklevel=2
                )

    def load_file(self, path: Path) -> list[Effect]:
        """Register the effects of a Python file, its `EFFECT` or `EFFECTS`; an `InputError` is one line that names the file."""
        spec = importlib.util.spec_from_file_location(f"{FILE_MODULE}{path.stem}", path)
        if not path.is_file() or spec is None or spec.loader is None:
            raise InputError(f"{path}: no such Python file")
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
            return self.register_all(collect_effects(module))
        except (Exception, SystemExit) as fault:  # anything may be in it
            raise InputError(f"{path}: {_format_exception(fault)}") from fault

    def register_all(self, effects: Iterable[Effect]) -> list[Effect]:
        """Add several effects."""
        added = list(effects)
        for effect in added:
            self.register(effect)
        return added


class View(Mapping[str, Kind]):
    """The effects of one kind, on sun and Earth sensors or all others; it follows its registry."""

    def __init__(self, registry: Registry, kind: type[Kind], on_sensors: bool):
        self._registry = registry
        self._kind = kind
        self._on_sensors = on_sensors

    def _has(self, effect: Effect) -> TypeGuard[Kind]:
        return isinstance(effect, self._kind) and (effect.stage == "sensor") == self._on_sensors

    def __getitem__(self, name: str) -> Kind:
        effect = self._registry[name]
        if not self._has(effect):
            raise KeyError(name)
        return effect

    def __iter__(self) -> Iterator[str]:
        return (name for name, effect in self._registry.items() if self._has(effect))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def collect_effects(source: object) -> list[Effect]:
    """Collect the effects that an entry point or a module gives."""
    if isinstance(source, ModuleType):
        given = [getattr(source, name) for name in ("EFFECT", "EFFECTS") if hasattr(source, name)]
        if not given:
            raise InputError("defines neither EFFECT nor EFFECTS")
        return [effect for member in given for effect in collect_effects(member)]
    if isinstance(source, Effect):
        return [source]
    if isinstance(source, list | tuple) and all(isinstance(member, Effect) for member in source):
        return list(source)
    raise InputError(f"gives {type(source).__name__}, not an Effect or several")


def _format_exception(fault: BaseException) -> str:
    """Format an exception in one line; with its type unless it is bad input."""
    words = " ".join(str(fault).split())
    return words if isinstance(fault, InputError) else f"{type(fault).__name__}: {words}"


REGISTRY = Registry()
ALL_EFFECTS: Mapping[str, Effect] = REGISTRY
EFFECTS: Mapping[str, Effect] = View(REGISTRY, Effect, on_sensors=False)

"""Reference error at twice orbit rate, e = size · sin(2 n t + φ); see `simulator.effects.reference.reference_orbital`."""

from simulator.effects.common import PHASE
from simulator.effects.reference.reference_orbital import ReferenceHarmonic

EFFECT = ReferenceHarmonic(
    name="reference_horizon",
    summary="reference error at twice orbit rate",
    unit="deg",
    stage="reference",
    prior=(5e-4, 5.0),
    bounds=(-90.0, 90.0),
    parameters=(PHASE,),
    order=2,
    meaning="The reference attitude errs sinusoidally twice an orbit, as Earth sensors do over an oblate Earth.",
)

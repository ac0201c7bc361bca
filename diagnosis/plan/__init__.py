"""What a maneuver plan will show: the smallest visible size of each effect, what it cannot separate, what would help.

`plan` answers from the linear model of the diagnosis alone, by parts:

- `columns`: the signature x of each effect
- `visibility`: the smallest visible size, by the statistic and the threshold of the diagnosis itself
- `named`: the smallest size at which the effect is also named
- `samples`: the same of effects seen in the samples
- `separability`: pairs that cannot be told apart
- `extras`: extra maneuvers and what each would help
- `planning`: all of it in turn; `result`: what comes out
"""

from diagnosis.plan.columns import RandomColumns, Signature, noise_free, random_columns, signatures
from diagnosis.plan.extras import appended, maneuvers
from diagnosis.plan.named import named_size
from diagnosis.plan.planning import plan
from diagnosis.plan.result import POWER, Extra, Pair, Plan, Visible, tables
from diagnosis.plan.samples import quiet_samples
from diagnosis.plan.separability import EXACT, LIMIT_SNR, SURE, pairs, separating_snr, shares, telling_size
from diagnosis.plan.visibility import PowerOf, random_seen, visible

__all__ = [
    "EXACT",
    "LIMIT_SNR",
    "POWER",
    "SURE",
    "Extra",
    "Pair",
    "Plan",
    "PowerOf",
    "RandomColumns",
    "Signature",
    "Visible",
    "appended",
    "maneuvers",
    "named_size",
    "noise_free",
    "pairs",
    "plan",
    "quiet_samples",
    "random_columns",
    "random_seen",
    "separating_snr",
    "shares",
    "signatures",
    "tables",
    "telling_size",
    "visible",
]

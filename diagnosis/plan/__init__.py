"""What a maneuver plan will show: the smallest visible size of each effect, what it cannot separate, what would help.

`plan` answers from the linear model of the diagnosis alone, by parts:

- `columns`: the signature x of each effect
- `visibility`: the smallest visible size, by the statistic and the threshold of the diagnosis itself
- `separability`: pairs that cannot be told apart
- `extras`: extra maneuvers and what each would help
- `pipeline`: all of it in turn; `result`: what comes out, and thresholds
- `invisible`: effects that a recording cannot show, which a calibration uses; hence nothing is imported here
"""

"""Predict what a maneuver plan can show: smallest visible sizes, inseparable pairs of effects, and helpful extra maneuvers.

All predictions use the linear model of the diagnosis:

- `columns`: the signature x of each effect
- `visibility`: the smallest visible size, by the statistic and the threshold of the diagnosis itself
- `separability`: pairs that cannot be distinguished
- `extras`: extra maneuvers and their improvements
- `pipeline`: `plan`, all parts in turn; `result`: the result, and thresholds
- `invisible`: effects that a recording cannot show, which a calibration uses; hence nothing is imported here
"""

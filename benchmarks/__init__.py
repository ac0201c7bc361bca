"""How fast and how small gyrocal is, against other ways of doing the same, side by side in one run: ``python -m benchmarks``.

Times on two machines, or on one at two moments, do not compare; ratios of one run do. So the candidates take turns, one call
each in every round, and the least time of each is kept: what disturbs a machine only ever adds. One thread.
"""

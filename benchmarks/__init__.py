"""Speed and memory of gyrocal against alternatives, in one run: ``python -m benchmarks``.

Times of two machines, or of one at two moments, cannot be compared; ratios of one run can. So the candidates take turns, one
call each in every round, and the least time of each is kept, since disturbances only add time. One thread.
"""

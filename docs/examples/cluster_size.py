"""How many workers of a Dask cluster a study can use: cases a second by workers, and the bound of the slowest station."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from studies.montecarlo.cluster_load import ClusterCosts, compute_throughput_bound, simulate_cluster
from studies.report.panels import GREY, Line, draw_panels, make_curves, make_shades, save

CASE_S, CHUNKS, TASKS = 1.0, (1, 8, 64), 5  # seconds of a case; cases of a task; tasks of each worker
measured = Path(__file__).parents[2] / "results" / "benchmarks" / "scale.json"
costs = replace(ClusterCosts(**json.loads(measured.read_text())["costs"]), case_s=CASE_S)
workers = np.unique(np.geomspace(1, 10_000, 9).round().astype(int))

lines = []
for chunk, colour in make_shades(CHUNKS).items():
    cases = [TASKS * chunk * count for count in workers]
    rate = [n / simulate_cluster(costs, count, chunk, n) for count, n in zip(workers, cases, strict=True)]
    bound = [compute_throughput_bound(costs, count, chunk) for count in workers]
    lines.append(Line(workers, rate, f"chunk of {chunk}", colour, "o"))
    lines.append(Line(workers, bound, "bound" if chunk == CHUNKS[-1] else "", GREY, "-"))
    print(f"chunk of {chunk}: at most {max(bound):.0f} cases a second")
axes = {"x": "workers", "y": "cases of 1 s, per second", "log": "xy", "legend": "upper left"}
save(draw_panels(make_curves(lines, **axes), size=(6.0, 3.2)), Path("cluster_size.svg"))

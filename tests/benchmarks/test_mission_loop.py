"""The loop's benchmark compares two ways of flying the same; how fast either is, is not tested."""

from benchmarks import mission_loop


def test_compiled_and_plain_fly_the_same():
    document = mission_loop.run(days=0.01, plain_seconds=30.0, rounds=1)
    assert document["difference_deg"] < mission_loop.AGREEMENT_DEG
    assert document["plain_vs_compiled"] > 1.0

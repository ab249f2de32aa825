"""A few fixed cases of `docs/benchmarks/soak/fuzz.py`: damaged and shortened files of every format, and wrong calls."""

import fuzz
import pytest

pytestmark = pytest.mark.slow
SEED = 26


@pytest.mark.parametrize(("kind", "count"), [("files", 276), ("short", 184), ("calls", 1000)])
def test_what_is_damaged_or_wrong_ends_in_a_result_or_in_one_line(kind, count):
    assert fuzz.run(kind, range(count), SEED, 1) == []


def test_whatever_else_comes_of_a_case_is_found(monkeypatch, capsys):
    monkeypatch.setattr(fuzz, "DEADLINE", 1.0)  # the worker has its own deadline, and sleeps longer
    monkeypatch.setattr(fuzz, "MOST", 1 << 25)
    found = fuzz.run("faults", range(2 * len(fuzz.FAULTS)), SEED, 1)
    assert {name.split(":")[0] for name in found} == set(fuzz.FAULTS) - {"refused"}
    assert capsys.readouterr().out.count("    2 x ") == len(found)

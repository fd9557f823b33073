"""How the benchmark of hidden effects scores a next test that was made on the plant."""

import runpy
from pathlib import Path

import pytest

REPORT = runpy.run_path(str(Path(__file__).resolve().parent.parent / "benchmarks" / "hidden_report.py"))
resolved, causes_of, by_power = (REPORT[name] for name in ("resolved", "causes_of", "_by_power"))

FRICTION, LAP, GAP = "spool_coulomb_friction", "spool_lap", "null_gap_asymmetry"


def row(truth, before, separates, after, power=0.9):
    return {
        "labels": truth.split(" + "),
        "candidates": [{"label": label, "labels": label.split(" + "), "in_set": True} for label in before],
        "next_test": {"separates": separates, "power": power},
        "after_next_test": {"in_set": after},
    }


@pytest.mark.parametrize(
    ("after", "is_resolved"),
    [
        ([FRICTION], True),
        ([FRICTION, GAP], True),  # the other of the two left
        ([FRICTION, LAP], False),
        ([LAP], False),  # the truth left
        ([GAP], False),
        ([], False),
    ],
)
def test_resolved_is_one_of_the_two_gone_and_the_truth_not(after, is_resolved):
    assert resolved(row(FRICTION, [LAP, FRICTION], [LAP, FRICTION], after)) is is_resolved


def test_a_truth_that_was_not_in_the_set_cannot_be_lost():
    assert resolved(row(GAP, [LAP, FRICTION], [LAP, FRICTION], [LAP]))


def test_a_pair_is_the_same_in_whatever_order_its_causes_stand():
    pair, turned = f"{FRICTION} + {LAP}", f"{LAP} + {FRICTION}"
    assert causes_of(pair) == causes_of(turned)
    assert not resolved(row(pair, [pair, LAP], [pair, LAP], [turned, LAP]))
    assert resolved(row(pair, [pair, LAP], [pair, LAP], [turned]))


def test_a_figure_is_the_effect_that_it_is_by_definition():
    figure = "parameter:null_gap_difference"
    assert causes_of(figure) == causes_of(GAP)
    assert resolved(row(GAP, [figure, LAP], [figure, LAP], [GAP]))
    assert not resolved(row(GAP, [figure, LAP], [figure, LAP], [GAP, LAP]))


def test_the_mean_predicted_power_stands_beside_the_share_resolved():
    sure = [row(FRICTION, [LAP, FRICTION], [LAP, FRICTION], [FRICTION], power) for power in (0.8, 1.0)]
    unsure = [row(FRICTION, [LAP, FRICTION], [LAP, FRICTION], [LAP, FRICTION], 0.0)]
    lines = by_power([*sure, *unsure]).splitlines()[2:]
    assert [line.split(" | ")[1:3] for line in lines] == [["1", "0.00"], ["2", "0.90"]]
    assert "(0 of 1;" in lines[0] and "(2 of 2;" in lines[1]

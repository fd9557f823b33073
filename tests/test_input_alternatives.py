"""Causes under other ways of the commands."""

from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import input_alternatives
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.fit import with_shapes
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION


@pytest.mark.parametrize(
    "left, best",
    [
        ((2e3, 1e3), 1),  # with fewer rows, and less of them
        ((2e3, 1.99e3), 0),  # by less than chance
        ((1e3, None), 0),  # under which it cannot be run
    ],
)
def test_the_way_of_the_commands_by_which_a_cause_explains_far_more_is_taken(monkeypatch, left, best):
    rows = (1e4, 1.2e4)
    study = SimpleNamespace(options=IDENTIFICATION, weights={})
    ways = [SimpleNamespace(study=study, way=k) for k in range(2)]
    fits = [None if more is None else SimpleNamespace(chi_square=n + more, rows=n, way=k, predicted_reduction=0.0)
            for k, (n, more) in enumerate(zip(rows, left, strict=True))]  # fmt: skip
    monkeypatch.setattr(input_alternatives, "under_other_inputs", lambda nominal: ways[1:])
    monkeypatch.setattr(input_alternatives, "fit_from_prior", lambda other, start, few: fits[other.way])
    monkeypatch.setattr(input_alternatives, "_excess", lambda study, fit, weights: fit.chi_square - fit.rows)
    fits[0].fitted = ()
    at, fit = input_alternatives.best_inputs(ways[0], fits[0], 2)
    assert (at.way, fit.way) == (best, best)


@pytest.mark.parametrize(
    "late, left, best",
    [
        (True, (3e3, 1e3), 2),
        (True, (1e3, None), 1),
        (True, (4.98e3, 4.98e3), None),  # by less than chance
        (False, (1e3, 1e3), None),  # no sensor is later than it may be
    ],
)
def test_the_ways_of_the_commands_are_run_again_beside_the_best_cause_from_its_figures(monkeypatch, late, left, best):
    rows = 1e4
    study = SimpleNamespace(options=IDENTIFICATION, weights={}, unweighted=lambda: study)
    cause = SimpleNamespace(chi_square=rows + 5e3, rows=rows, point=None, fitted=())
    ways = [SimpleNamespace(study=study, fit=SimpleNamespace(point=k), way=k) for k in range(3)]
    fits = [
        None if more is None else SimpleNamespace(chi_square=rows + more, rows=rows, way=k + 1, predicted_reduction=0.0)
        for k, more in enumerate(left)
    ]

    def under_other(nominal, beside):
        assert (nominal, beside) == (ways[0], cause)
        return ways[1:]

    for name, stub in {
        "has_implausible_delays": lambda study, point: late,
        "under_other_inputs": under_other,
        "fit_from_prior": lambda other, start, few: fits[other.way - 1],
        "_excess": lambda study, fit, weights: fit.chi_square - fit.rows,
        "has_uncertain_inputs": lambda study: True,
        "fit_nominal_near": lambda study, point, *, full_weight: (point, full_weight),
    }.items():
        monkeypatch.setattr(input_alternatives, name, stub)
    found = input_alternatives.with_inputs_of_cause(ways[0], cause, options=DIAGNOSIS)
    assert found == (None if best is None else ((best, False), fits[best - 1]))


@pytest.mark.parametrize(
    "pair, left, best",
    [
        (0.0, (90.0, -50.0, 80.0, 70.0), 1),
        (0.0, (90.0, -50.0, 80.0, -60.0), 3),
        (-70.0, (90.0, -50.0, 80.0, -60.0), None),  # both explain more than either does under any way
        (0.0, (90.0, None, -5.0, 70.0), None),  # by no more than chance than under the way that is
    ],
)
def test_one_cause_under_another_way_of_the_commands_is_held_against_two_under_this(monkeypatch, pair, left, best):
    """A chirp taken as straight lines is too small: with an eddy current stood an armature twice as inert (970196)."""
    rows = 1e4
    study = SimpleNamespace(options=IDENTIFICATION, weights={}, unweighted=lambda: study)
    both = SimpleNamespace(chi_square=rows + pair, rows=rows)
    alone = [SimpleNamespace(chi_square=rows + more, rows=rows, fitted=k) for k, more in ((0, 90.0), (2, 20.0))]
    ways = [SimpleNamespace(study=study, fit=SimpleNamespace(point=k), way=k) for k in range(3)]
    excess = {(0, 1): left[0], (0, 2): left[1], (2, 1): left[2], (2, 2): left[3]}
    fits = {
        key: None if more is None else SimpleNamespace(chi_square=rows + more, rows=rows, predicted_reduction=0.0)
        for key, more in excess.items()
    }
    for name, stub in {
        "under_other_inputs": lambda nominal, beside: ways[1:],
        "fit_from_prior": lambda other, start, few: fits[start, other.way],
        "_excess": lambda study, fit, weights: fit.chi_square - fit.rows,
        "has_uncertain_inputs": lambda study: True,
        "fit_nominal_near": lambda study, point, *, full_weight: (point, full_weight),
    }.items():
        monkeypatch.setattr(input_alternatives, name, stub)
    found = input_alternatives.with_inputs_of_one_cause(ways[0], both, alone, options=DIAGNOSIS)
    ended = {1: (0, 2), 3: (2, 2)}
    assert found == (None if best is None else ((2, False), fits[ended[best]]))


@pytest.mark.parametrize(
    "left, promised, ended, best",
    [
        ((4e3, 4e3), (10.0, 3.9e3), (None, 200.0), 1),  # it has stopped far short (991196)
        ((4e3, 4e3), (3.9e3, 3.9e3), (100.0, 200.0), 0),  # so have both
        ((4e3, 9e3), (10.0, 3.9e3), (None, None), 0),  # it promises less than the other leaves
        ((4e3, 4.1e3), (10.0, 25.0), (None, None), 0),  # by less than chance
    ],
)
def test_a_way_of_the_commands_that_promises_to_be_the_best_is_fitted_further(
    monkeypatch, left, promised, ended, best
):
    rows, continued = 1e4, []

    def fit(way, more, promise):
        return SimpleNamespace(chi_square=rows + more, rows=rows, way=way, predicted_reduction=promise)

    ways = [SimpleNamespace(study=SimpleNamespace(options=IDENTIFICATION), way=k) for k in range(2)]

    def further(way, one, worthwhile):
        assert worthwhile == rows + min(left)  # one that ends above is not the best
        continued.append(way.way)
        return fit(way.way, ended[way.way], 0.0)

    for name, stub in {
        "fit_from_prior": lambda way, start, few: fit(way.way, left[way.way], promised[way.way]),
        "continue_from": further,
        "_excess": lambda study, fit, weights: fit.chi_square - fit.rows,
    }.items():
        monkeypatch.setattr(input_alternatives, name, stub)
    begun = input_alternatives._preliminary_fits([(way, ()) for way in ways], 2)
    at, _ = input_alternatives._best_way(begun, np.inf, {})
    assert at.way == best and continued == [k for k in range(2) if ended[k] is not None]


def test_ways_of_the_commands_are_judged_by_the_samples_that_count_under_all(monkeypatch):
    """A hold makes readings peak at each of its samples: few of them counted, and it seemed to leave less."""
    key, other = ("r", "flow"), ("r", "leakage")
    weights = [{key: np.array([1.0, 0.2, 1.0])}, {}, {key: np.array([0.5, 1.0, 1.0]), other: np.ones(2)}]
    ways = [SimpleNamespace(study=SimpleNamespace(weights=each)) for each in weights]
    least = input_alternatives._least_weights(ways)
    assert set(least) == {key, other} and least[key].tolist() == [0.5, 0.2, 1.0] and least[other].tolist() == [1.0, 1.0]
    assert input_alternatives._least_weights(ways[1:2]) == {} and weights[0][key].tolist() == [1.0, 0.2, 1.0]


@pytest.mark.parametrize("left, taken", [
    ({"straight": 300.0, "smooth": 500.0}, "straight"), ({"straight": 900.0}, None),
])  # fmt: skip
def test_a_cause_that_explains_far_more_under_another_way_is_found_from_what_is_typical_of_it(
    monkeypatch, left, taken
):
    """Under a hold the lag of a current loop had ended near none, and nothing was named (1310100)."""
    candidate = SimpleNamespace(typical=5e-4, fixed=(), shapes=tuple)
    ended = SimpleNamespace(fitted=(with_shapes(candidate, 1e-6),))
    study = SimpleNamespace(options=IDENTIFICATION, weights={}, unweighted=lambda: study)
    nominal = SimpleNamespace(study=study)
    ways = [SimpleNamespace(study=study, fit=SimpleNamespace(point=name), name=name) for name in left]
    begun = []

    def fit(way, start, few):
        begun.append(start[0].above_neutral)
        return SimpleNamespace(chi_square=1e4 + left[way.name], rows=1e4, fitted=start, predicted_reduction=0.0)

    for name, stub in {
        "under_other_inputs": lambda nominal: ways,
        "fit_from_prior": fit,
        "_excess": lambda study, fit, weights: fit.chi_square - 1e4,
        "fitted_under": lambda nominal, at: at.name,
    }.items():
        monkeypatch.setattr(input_alternatives, name, stub)
    best = SimpleNamespace(chi_square=1e4 + 600.0, fitted=())
    pair = SimpleNamespace(fitted=(*ended.fitted, *ended.fitted))
    found = input_alternatives.with_inputs_of_any_cause(nominal, best, [pair, ended], options=DIAGNOSIS)
    assert (None if found is None else found[0]) == taken and begun == [candidate.typical] * len(left)
    assert input_alternatives.with_inputs_of_any_cause(nominal, best, [pair], options=DIAGNOSIS) is None


@pytest.mark.parametrize(("there", "taken"), [(500.0, "lines"), (590.0, None)])
def test_a_cause_that_shows_under_another_way_of_the_commands_explains_more_there_than_a_pair_here(
    monkeypatch, there, taken
):
    """An eddy current's lag of 0.55 ms was a command held for 1 ms, beside two false figures of the armature (`poor`
    213007).
    """
    study = SimpleNamespace(options=IDENTIFICATION)
    nominal, start = SimpleNamespace(study=study), (SimpleNamespace(candidate="eddy"),)
    ways = [SimpleNamespace(study=study, fit=SimpleNamespace(), name=name) for name in ("lines", "edges")]
    left = {"lines": there, "edges": 700.0}

    def fit(way, begun, few):
        assert begun is start
        return SimpleNamespace(chi_square=left[way.name], fitted=begun, predicted_reduction=0.0)

    for name, stub in {
        "under_other_inputs": lambda nominal: ways,
        "score_test": lambda way, fit, *, options: SimpleNamespace(options=options, z=lambda: np.array([13.0])),
        "single_starts": lambda scores, fall, share: [start],
        "fit_from_prior": fit,
        "_least_weights": lambda ways: {},
        "_excess": lambda study, fit, weights: fit.chi_square,
        "fitted_under": lambda nominal, at: at.name,
    }.items():
        monkeypatch.setattr(input_alternatives, name, stub)
    pair = SimpleNamespace(chi_square=600.0)
    found = input_alternatives.with_inputs_of_likeliest_cause(nominal, pair, options=DIAGNOSIS)
    assert (None if found is None else found[0]) == taken
    assert found is None or found[1].fitted is start


@pytest.mark.parametrize(("there", "promised", "told"), [(605.0, 0.0, True), (607.0, 0.0, False), (630.0, 40.0, True)])
def test_another_cause_that_explains_as_much_under_another_way_of_the_commands_is_told(
    monkeypatch, there, promised, told
):
    """Of an eddy current a figure of the armature's damping was named for sure, under commands that were taken as held
    (`poor` 213016, with its next test).
    """
    study, candidate = SimpleNamespace(options=IDENTIFICATION), SimpleNamespace(name="eddy")
    way = SimpleNamespace(study=study)
    begun = SimpleNamespace(
        chi_square=there, predicted_reduction=promised, fitted=(SimpleNamespace(candidate=candidate),)
    )
    ended = SimpleNamespace(chi_square=there - promised)
    best = SimpleNamespace(chi_square=600.0, fitted=(SimpleNamespace(candidate=SimpleNamespace(name="damping")),))
    for key, stub in {
        "_begun_under_other_inputs": lambda nominal, named, *, options: ([(way, begun)], {}),
        "_excess": lambda study, fit, weights: fit.chi_square,
        "continue_from": lambda way, fit, worthwhile: ended if worthwhile == 606.0 else None,
        "has_chosen_inputs": lambda study: study is nominal.study,
    }.items():
        monkeypatch.setattr(input_alternatives, key, stub)
    nominal = SimpleNamespace(study=study)
    found = input_alternatives.cause_under_other_inputs(nominal, best, options=DIAGNOSIS)
    assert found is (candidate if told else None)
    monkeypatch.setattr(input_alternatives, "has_chosen_inputs", lambda study: False)
    assert input_alternatives.cause_under_other_inputs(nominal, best, options=DIAGNOSIS) is None


@pytest.mark.parametrize(
    "named, fitted", [(None, ["eddy", "damping"]), ("damping", ["eddy"]), ("lap", ["eddy", "damping"])]
)
def test_under_other_ways_the_cause_that_is_named_already_is_not_fitted_again(monkeypatch, named, fitted):
    ways, begun = ["edges", "held"], []
    shown = {"edges": "eddy", "held": "damping"}

    def fits(starts, few):
        begun.extend(start[0].candidate.name for _, start in starts)
        return starts

    for key, stub in {
        "under_other_inputs": lambda nominal: ways,
        "_likeliest_under": lambda way, *, options: [(SimpleNamespace(candidate=SimpleNamespace(name=shown[way])),)],
        "_preliminary_fits": fits,
        "_least_weights": lambda ways: {},
    }.items():
        monkeypatch.setattr(input_alternatives, key, stub)
    known = SimpleNamespace(name=named) if named else None
    input_alternatives._begun_under_other_inputs("nominal", known, options=DIAGNOSIS)
    assert begun == fitted

"""Names of errors, the hint at the nearest valid name, and warnings that are given once."""

import pickle
import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import (
    InputError,
    SolveError,
    ValidityWarning,
    ValvesimError,
    forget_warnings,
    nearest,
    unknown_name,
    warn_once,
)

NAMES = ("supply_pressure", "return_pressure", "nozzle_diameter")
names = st.text("abcdefgh_", min_size=1, max_size=12)


def warned(*messages):
    """What `warn_once` passes on of some messages."""
    with warnings.catch_warnings(record=True) as given_:
        warnings.simplefilter("always")
        for message in messages:
            warn_once(message)
    return [(w.category, str(w.message)) for w in given_]


@pytest.mark.parametrize("kind, built_in", [(InputError, ValueError), (SolveError, RuntimeError)])
def test_an_error_is_one_of_the_package_and_of_python(kind, built_in):
    assert issubclass(kind, ValvesimError) and issubclass(kind, built_in)


def test_input_and_solve_errors_are_told_apart():
    assert not issubclass(InputError, SolveError) and not issubclass(SolveError, InputError)


def test_a_validity_warning_is_given_once():
    forget_warnings()
    assert warned("cold", "cold", "hot") == [(ValidityWarning, "cold"), (ValidityWarning, "hot")]
    assert warned("cold") == []


def test_a_forgotten_warning_is_given_again():
    forget_warnings()
    warned("cold")
    forget_warnings()
    assert warned("cold") == [(ValidityWarning, "cold")]


def test_a_validity_warning_points_at_the_caller():
    forget_warnings()
    with warnings.catch_warnings(record=True) as given_:
        warnings.simplefilter("always")
        warn_once("cold")
    assert given_[0].filename == __file__


@pytest.mark.parametrize(
    "name, hint",
    [
        ("suply_pressure", "; did you mean 'supply_pressure'?"),
        ("nozle_diameter", "; did you mean 'nozzle_diameter'?"),
        ("return pressure", "; did you mean 'return_pressure'?"),
        ("xyz", "; valid names: nozzle_diameter, return_pressure, supply_pressure"),
        ("", "; valid names: nozzle_diameter, return_pressure, supply_pressure"),
    ],
)
def test_a_wrong_name_gets_the_nearest_one_or_all(name, hint):
    assert nearest(name, NAMES) == hint


def test_without_valid_names_there_is_no_hint():
    assert nearest("x", ()) == ""


@given(names, st.lists(names, min_size=1))
def test_a_hint_names_only_valid_names(name, valid):
    hint = nearest(name, iter(valid))
    if hint.startswith("; did you mean"):
        assert hint.split("'")[1] in valid
    else:
        assert hint == "; valid names: " + ", ".join(sorted(valid))


@given(names, st.lists(names, min_size=1))
def test_a_valid_name_is_nearest_to_itself(name, valid):
    assert nearest(name, [*valid, name]) == f"; did you mean {name!r}?"


@pytest.mark.parametrize(
    "where, message",
    [
        ("", "unknown key 'suply_pressure'; did you mean 'supply_pressure'?"),
        ("valve", "valve: unknown key 'suply_pressure'; did you mean 'supply_pressure'?"),
    ],
)
def test_an_unknown_name_says_what_where_and_the_nearest(where, message):
    error = unknown_name("key", "suply_pressure", NAMES, where)
    assert type(error) is InputError and str(error) == message


# --- fields ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields, text",
    [
        ({}, "is wrong"),
        ({"key": "valve.null_gap"}, "valve.null_gap: is wrong"),
        ({"key": "valve.null_gap", "joint": " "}, "valve.null_gap is wrong"),
        ({"file": "a.toml"}, "a.toml: is wrong"),
        ({"file": "a.toml", "line": 3, "key": "valve"}, "a.toml, line 3: valve: is wrong"),
        ({"setting": "valve.x=1", "key": "valve.x"}, "--set 'valve.x=1': valve.x: is wrong"),
    ],
)
def test_the_text_of_an_error_is_made_of_its_fields(fields, text):
    error = InputError("is wrong", **fields)
    assert str(error) == text and str(error.at()) == text
    assert str(pickle.loads(pickle.dumps(error))) == text  # it may come from another process


def test_the_keys_of_an_error_hold_the_unknown_name_and_what_is_related():
    assert unknown_name("key", "gpa", NAMES, "valve").keys == ("valve.gpa",)
    assert unknown_name("key", "vlave", NAMES).keys == ("vlave",)
    assert InputError("too long", key="pulse.width", related=("pulse.period",)).keys == ("pulse.width", "pulse.period")
    assert InputError("no record").keys == ()


@pytest.mark.parametrize(
    "key, old, new, moved",
    [
        ("pulse.width", "pulse", "command.current.pulse", "command.current.pulse.width"),
        ("pulse", "pulse", "command.current.pulse", "command.current.pulse"),
        ("pulse.width", "", "command.current", "command.current.pulse.width"),
        ("oil.rated_low", "oil", "", "rated_low"),
        ("oils.rated_low", "oil", "", "oils.rated_low"),  # another table
        ("", "", "command.current", ""),
    ],
)
def test_keys_move_from_table_to_table(key, old, new, moved):
    error = InputError("is wrong", key=key, related=(key,)).moved(old, new)
    assert (error.key, error.related) == (moved, (moved,))

"""What every test starts from: no validity warning given yet, none an error, hypothesis without clock or dice."""

import os
import sys
import warnings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded: there is a worker to each core

import pytest
from hidden_plant import draw, shortened, write_session
from hypothesis import HealthCheck, settings

from valvesim.cli import main as cli
from valvesim.errors import forget_warnings
from valvesim.identification.nominal_fit import fit_nominal
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session

# derandomize: the same examples in every run, so that a failure is never a matter of luck; nor of a busy machine,
# on which examples take longer to draw
settings.register_profile(
    "valvesim", deadline=None, max_examples=50, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.too_slow],
)  # fmt: skip
settings.load_profile("valvesim")


def pytest_collection_modifyitems(items):
    """Ignore `ValidityWarning` unless the test sets its own filters (`pytest.warns` sees it either way)."""
    for item in items:
        if item.get_closest_marker("filterwarnings") is None:
            item.add_marker(pytest.mark.filterwarnings("ignore::valvesim.errors.ValidityWarning"))


@pytest.fixture(autouse=True)
def _nothing_trusted(monkeypatch, tmp_path_factory):
    """Each test starts with no file of effects trusted, whatever the user's own list holds."""
    monkeypatch.setenv("VALVESIM_DATA_DIR", str(tmp_path_factory.getbasetemp() / "data_of_no_one"))


@pytest.fixture(autouse=True)
def _validity_warnings_forgotten():
    """Each test sees the once-only warnings as a new process would."""
    forget_warnings()
    yield
    forget_warnings()


@pytest.fixture(scope="session")
def biased_session(tmp_path_factory):
    """A session of the hidden plant, of half a second a record, in which the load flow sensor is far off."""
    folder = tmp_path_factory.mktemp("biased")
    write_session(shortened(draw(9, "sensor", name="sensor_bias"), 501), folder)
    return load_session(folder)


@pytest.fixture(scope="session")
def biased_fit(biased_session):
    """The base fit of that session."""
    return fit_nominal(prepare_session(biased_session))


@pytest.fixture
def call(monkeypatch, capsys):
    """Run a command line in this process: (exit code, standard output, standard error)."""
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # `main` sets its own

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["valvesim", *map(str, words)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code
        return (code, *capsys.readouterr())

    return call

"""Binary formats are read in a process of their own: what a file or its library does to it is one line here."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from valvesim.errors import InputError
from valvesim.measurement import reader_process
from valvesim.measurement.recording import read_recording

DAMAGED = Path(__file__).parent / "damaged"
IN_PROC = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
ENDLESS = "sum(iter(int, 1))"  # never lets go of the interpreter


@pytest.fixture(autouse=True)
def _fresh():
    """No process that another test has started, nor one with its libraries for the next."""
    reader_process._end_all()
    yield
    reader_process._end_all()


@pytest.fixture
def library(tmp_path, monkeypatch):
    """Puts a library in place of npTDMS that does something when it opens a file; gives the file."""

    def library(body):
        (tmp_path / "own").mkdir()
        lines = "\n        ".join(["import os, sys", *body.splitlines()])
        text = f"class TdmsFile:\n    @staticmethod\n    def open(path):\n        {lines}\n"
        (tmp_path / "own" / "nptdms.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path / "own")
        (tmp_path / "a.tdms").write_bytes(b"TDSm")
        return tmp_path / "a.tdms"

    return library


def _good(path):
    savemat(path, {"time_s": np.arange(100) / 1e3, "current_A": np.sin(np.arange(100))})
    return path


def _read(path):
    return read_recording([path], ["current"]).values["current"]


BEHAVIOUR = {
    "crash": ("os.abort()", "its library crashed, SIGABRT); is it whole? Write it anew, or as CSV"),
    "exit": ("os._exit(3)", "its library crashed, exit code 3"),
    "killed": ("os.kill(os.getpid(), 9)", "or more memory than there is"),
    "endless": (ENDLESS, "its library was not done in 0.3 s of processor time"),
    "memory": ("bytearray(10**13)", "it asks for more memory than there is"),
    "an answer": ("os.write(1, b'{}'); raise KeyError('x' * 999)", "xxxxx)"),
    "nonsense": ("[os.write(k, b'?') for k in range(3, 9)]", "or more memory than there is"),
    "a stranger's error": ("class Own(BaseException): pass\nraise Own", "its library crashed, exit code 1"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("body, told", BEHAVIOUR.values(), ids=BEHAVIOUR.keys())
def test_whatever_a_library_does_is_one_line(library, monkeypatch, capfd, body, told):
    monkeypatch.setattr(reader_process, "MOST_SECONDS", 0.3)
    path = library(body)
    with pytest.raises(InputError) as caught:
        _read(path)
    assert str(caught.value).startswith(f"{path}: is no TDMS file that can be read (") and told in str(caught.value)
    assert capfd.readouterr() == ("", "") and not reader_process._idle


def test_what_waits_without_working_ends_too(library, monkeypatch):
    monkeypatch.setattr(reader_process, "MOST_SECONDS", 0.3)
    monkeypatch.setattr(reader_process, "LONGEST_WAIT", 0.0)
    monkeypatch.setattr(reader_process, "PATIENCE", 2.0)
    with pytest.raises(InputError, match=r"reading it took more than 0\.6 s"):
        _read(library("import time; time.sleep(600)"))


def test_a_missing_library_is_named_with_its_extra(library):
    path = library("")
    (path.parent / "own" / "nptdms.py").write_text("raise ImportError\n")
    with pytest.raises(InputError) as caught:
        _read(path)
    assert str(caught.value) == f"{path}: TDMS files need nptdms: pip install 'valvesim[tdms]'"


def test_a_matlab_file_of_an_unknown_type_of_number_crashes_scipy_alone(tmp_path):
    """Seed 13, case 868 of `benchmarks/robustness.py inputs`."""
    savemat(tmp_path / "a.mat", {"time": np.arange(100.0)})
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[176] = 41
    (tmp_path / "b.mat").write_bytes(data)
    with pytest.raises(InputError, match=r"b\.mat: is no MATLAB file that can be read .its library crashed, SIGSEGV"):
        _read(tmp_path / "b.mat")


def test_a_netcdf_file_that_holds_its_library_is_refused(monkeypatch):
    """Seed 13, case 2745 of `benchmarks/robustness.py inputs`."""
    monkeypatch.setattr(reader_process, "MOST_SECONDS", 0.5)
    with pytest.raises(InputError, match=r"endless\.nc: is no netCDF file .* not done in 0\.\d+ s of processor time"):
        _read(DAMAGED / "endless.nc")


def test_a_process_is_kept_for_the_next_file_unless_it_read_a_broken_one(tmp_path):
    good = _good(tmp_path / "a.mat")
    first = _read(good)
    (kept,) = reader_process._idle
    assert (_read(good) == first).all() and reader_process._idle == [kept]
    (tmp_path / "b.mat").write_bytes(b"MATLAB 5.0".ljust(2000))
    with pytest.raises(InputError, match="Unknown mat file type"):
        _read(tmp_path / "b.mat")
    assert not reader_process._idle and kept.process.returncode is not None
    assert (_read(good) == first).all()


def test_a_kept_process_that_was_ended_meanwhile_is_replaced(tmp_path):
    good = _good(tmp_path / "a.mat")
    first = _read(good)
    reader_process._idle[0].process.kill()
    reader_process._idle[0].process.wait()
    assert (_read(good) == first).all()


def test_what_goes_wrong_in_the_choice_is_told_as_it_is(tmp_path):
    def choice(headings):
        raise LookupError("own")

    with pytest.raises(LookupError, match="own"):
        reader_process.read_apart(_good(tmp_path / "a.mat"), "MATLAB", choice)
    assert not reader_process._idle


def test_threads_read_at_once(tmp_path):
    paths = [_good(tmp_path / f"{k}.mat") for k in range(8)]
    with ThreadPoolExecutor(3) as pool:
        read = list(pool.map(_read, paths))
    assert all((each == read[0]).all() for each in read) and 1 <= len(reader_process._idle) <= 3


def _in_worker(path, queue):
    queue.put(_read(path).sum())


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_read_with_a_process_of_their_own(tmp_path, method):
    good = _good(tmp_path / "a.mat")
    expected = _read(good).sum()
    context = get_context(method)
    queue = context.Queue()
    worker = context.Process(target=_in_worker, args=(good, queue), daemon=True)
    worker.start()
    assert queue.get(timeout=60.0) == expected
    worker.join()
    assert _read(good).sum() == expected  # its own process was left alone


# --- bombs, and names of other files ---------------------------------------------------------------------------------


def test_an_archive_that_unpacks_to_a_thousand_times_its_size_is_refused_at_once(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", b" " * 100_000_000)
    with pytest.raises(InputError, match=r"a\.xlsx: unpacks to 100 MB, more than 100 times its size"):
        _read(tmp_path / "a.xlsx")


def test_a_sheet_may_claim_any_width(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["time [s]", "current [A]"], *([k / 1e3, k] for k in range(30))):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    with zipfile.ZipFile(tmp_path / "a.xlsx") as good, zipfile.ZipFile(tmp_path / "b.xlsx", "w") as wide:
        for name in good.namelist():
            wide.writestr(name, re.sub(rb'dimension ref="[^"]*"', b'dimension ref="A1:XFD1048576"', good.read(name)))
    assert (_read(tmp_path / "b.xlsx") == np.arange(30.0)).all()


@pytest.mark.parametrize("suffix", [".mat", ".nc"])
@pytest.mark.parametrize("how", ["link", "external", "virtual"])
def test_no_file_is_read_that_another_names(tmp_path, suffix, how):
    """Neither a record that stands elsewhere, nor bytes of any file as numbers, nor a pipe that never ends."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.arange(20.0)
    (tmp_path / "secret").write_bytes(np.arange(20.0).tobytes())
    path = tmp_path / f"a{suffix}"
    with h5py.File(path, "w") as file:
        time = file.create_dataset("time", data=np.arange(20) / 1e3)
        time.make_scale("time")
        if how == "link":
            file["current"] = h5py.ExternalLink(tmp_path / "other.h5", "/x")
        elif how == "external":
            file.create_dataset("current", (20,), "f8", external=[(tmp_path / "secret", 0, 160)])
        else:
            layout = h5py.VirtualLayout((20,), dtype="f8")
            layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "x", shape=(20,))
            file.create_virtual_dataset("current", layout)
        if how != "link":
            file["current"].dims[0].attach_scale(time)
            file["current"].attrs["units"] = "A"
        time.attrs["units"] = "s"
    if (suffix, how) == (".nc", "virtual"):  # HDF5 has a fill value for what is not there, and netCDF tells no more
        assert not _read(path).any()
        return
    with pytest.raises(InputError, match="stands in another file" if suffix == ".mat" else "NetCDF: HDF error"):
        _read(path)


def test_more_columns_than_a_table_may_have_are_refused(tmp_path):
    savemat(tmp_path / "a.mat", {f"v{k}": np.arange(2.0) for k in range(4001)})
    with pytest.raises(InputError, match=r"a\.mat: 4001 columns are more than 4000"):
        _read(tmp_path / "a.mat")


# --- nobody is left --------------------------------------------------------------------------------------------------


def _running(session):
    """The processes of a session that are no zombies."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z" and int(fields[3]) == session:
            found.append(int(status.parent.name))
    return found


@IN_PROC
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_to_the_command_leaves_no_process_behind(library, tmp_path, number):
    path = library(f"open(path.parent / 'ready', 'w').close(); {ENDLESS}")
    command = subprocess.Popen(
        [sys.executable, "-c", "import signal; signal.signal(2, signal.SIG_DFL); "
         "from valvesim.cli.main import main; main()", "records", path, "-o", tmp_path / "out"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    waited = threading.Event()
    while not (tmp_path / "ready").exists():
        assert command.poll() is None, command.communicate()
        waited.wait(0.02)
    begun = time.monotonic()
    command.send_signal(number)
    out, err = command.communicate(timeout=60)
    while _running(command.pid):
        assert time.monotonic() - begun < 2.5, "the process that reads is left; it ends by itself after 3 s"
        waited.wait(0.02)
    if number == signal.SIGKILL:
        assert command.returncode == -number
    else:
        assert (command.returncode, err) == (128 + number, "error: interrupted; nothing half-written is left\n")


def test_ctrl_c_in_a_program_ends_the_process_that_reads(library, monkeypatch):
    monkeypatch.setattr(reader_process, "MOST_SECONDS", 600.0)  # no machine is so busy that this comes first
    path = library(ENDLESS)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT]).start()
            _read(path)
    finally:
        signal.signal(signal.SIGINT, before)
    assert not reader_process._idle

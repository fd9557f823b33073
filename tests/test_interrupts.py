"""A signal ends the process with one line, wherever it stands; streams that cannot be written are told or dropped."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from valvesim.cli import display, interrupts
from valvesim.cli.streams import CLOSED_PIPE
from valvesim.temporary_files import remove_all, temporary_folder, temporary_path

FULL = b"error: standard output or a temporary file: cannot be read or written (No space left on device)\n"
LINE = "error: interrupted; nothing half-written is left\n"
# Stands at a point that is given, with a temporary folder and a worker process, and tells the parent so.
PROGRAM = """
import os, signal, subprocess, sys, time
from pathlib import Path
from multiprocessing import get_context
from valvesim.cli.interrupts import SIGNALS, end_with_parent, ended_by_signals, hidden_from_children
from valvesim.temporary_files import temporary_folder

def work():
    end_with_parent()
    print("worker", os.getpid(), flush=True)
    time.sleep(600)

def compiled():
    import numba
    @numba.njit(nogil=True)
    def spin(n):
        x = 0.0
        while x >= 0.0:
            x += n
        return x
    spin.compile((numba.float64,))
    return lambda: spin(1e-9)

if __name__ == "__main__":
    for number in SIGNALS:  # which a test run in the background would have it ignore
        signal.signal(number, signal.SIG_DFL)
    with ended_by_signals(), temporary_folder(Path(sys.argv[1]), ".new-") as folder:
        (folder / "half").write_text("half")
        process = get_context("spawn").Process(target=work, daemon=True)
        with hidden_from_children():
            process.start()
        if sys.argv[2] == "program":
            subprocess.Popen(["sh", "-c", "sleep 600 & sleep 600"], cwd=sys.argv[1])
        stand = compiled() if sys.argv[2] == "compiled" else process.join
        print("ready", flush=True)
        stand()
"""


@pytest.fixture
def program(tmp_path):
    """Starts the program; (process, pid of its worker) once both stand."""

    def program(where):
        (tmp_path / "program.py").write_text(PROGRAM)
        (tmp_path / "place").mkdir()
        process = subprocess.Popen(
            [sys.executable, tmp_path / "program.py", tmp_path / "place", where],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        told = {(words := process.stdout.readline().split())[0]: words[1:] for _ in range(2)}
        return process, int(told["worker"][0])

    return program


def _alive(pid):
    """Whether a process still runs; a zombie, which waits for its parent, does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def _of_session(pid, session):
    """Whether a process belongs to a session; a zombie does not."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return False
    return fields[0] != "Z" and int(fields[3]) == session


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    "where, number, group",
    [("waiting", signal.SIGINT, True), ("program", signal.SIGTERM, False), ("compiled", signal.SIGINT, True)],
)
def test_a_signal_ends_process_worker_and_temporary_files(program, tmp_path, where, number, group):
    process, worker = program(where)
    (os.killpg if group else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (128 + number, LINE)
    assert not _alive(worker) and os.listdir(tmp_path / "place") == []
    gone = threading.Event()
    while any(_of_session(pid, process.pid) for pid in os.listdir("/proc") if pid.isdigit()):
        gone.wait(0.01)  # multiprocessing's own process reads that its parent is gone, and ends


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_worker_ends_with_a_parent_that_was_killed(program):
    process, worker = program("waiting")
    process.kill()
    process.wait()
    process.stdout.close()
    process.stderr.close()
    gone = threading.Event()
    while _alive(worker):
        gone.wait(0.01)


def test_inside_and_after_signals_are_as_they_were():
    before = [signal.getsignal(number) for number in interrupts.SIGNALS]
    with interrupts.ended_by_signals():
        assert signal.getsignal(signal.SIGTERM) not in before
    assert [signal.getsignal(number) for number in interrupts.SIGNALS] == before


def test_another_thread_hears_of_no_signals():
    seen = []

    def run():
        with interrupts.ended_by_signals():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGTERM)]


def test_temporary_files_go_with_their_block_or_before(tmp_path):
    old = tmp_path / ".new-old"
    old.mkdir()
    os.utime(old, (1.0, 1.0))
    with temporary_folder(tmp_path, ".new-") as folder, temporary_path(tmp_path, ".one-", ".png") as path:
        assert not old.exists() and folder.stat().st_mode & 0o777 == 0o700 and not path.exists()
        (folder / "a").write_text("a")
        path.write_text("b")
        remove_all()
        assert os.listdir(tmp_path) == []
        path.write_text("c")
    assert os.listdir(tmp_path) == []


# --- streams ---------------------------------------------------------------------------------------------------------


def _command(*words, stdout=subprocess.PIPE, **environment):
    words = [sys.executable, "-m", "valvesim.cli.main", *words]
    return subprocess.run(words, stdout=stdout, stderr=subprocess.PIPE, env=os.environ | environment)


def test_a_closed_pipe_is_nobodys_failure():
    here, there = os.pipe()
    os.close(here)
    try:
        done = _command("oils", stdout=there)
    finally:
        os.close(there)
    assert (done.returncode, done.stderr) == (CLOSED_PIPE, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disc_under_standard_output_is_one_line():
    with open("/dev/full", "wb") as full:
        done = _command("oils", "--format", "csv", stdout=full)
    assert done.returncode == 1 and done.stderr.count(b"\n") == 1
    assert done.stderr == FULL


def test_a_terminal_of_ascii_gets_plain_characters():
    done = _command("oils", PYTHONIOENCODING="ascii", LC_ALL="C")
    assert (done.returncode, done.stderr) == (0, b"")
    assert "rated [degC]" in done.stdout.decode("ascii") and "?" not in done.stdout.decode("ascii")


def test_control_characters_do_not_reach_the_terminal(capsys):
    display.print_table("a\x1b[31mred\x07", ["value"], [["\x1b]0;title\x07"]])
    display.print_written([Path("a\x1b[2J\nb")])
    display.print_rows([{"a": "\x1b[31m\n"}], "csv")
    out = capsys.readouterr().out
    assert "\x1b" not in out and "\x07" not in out
    assert "a\\x1b[31mred" in out and "wrote a\\x1b[2J\\nb" in out

"""What becomes of a command that gets a signal at some moment: the part of `robustness.py kills` that looks.

Each command runs in a session of its own, with earlier results of it in the output folder or none. After a random time
it gets Ctrl-C (SIGINT to its whole group, as a terminal sends it), SIGTERM, SIGHUP or SIGKILL. Outcomes:

ok           ended with 130, 143 or 129 (or was done), one line at most on standard error, results whole
traceback    more than one line on standard error, or another exit code
late         more than a second from the signal to the end
child        a process of its session is left a second after its end
lost         the folder holds neither the earlier results, whole, nor the new ones, whole
left         a temporary file or an empty folder is left (after SIGKILL, which nobody can hear, they are not counted)
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIGNALS = (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
LATE = 1.0  # s
LONGEST = 12.0  # s; a command that takes longer is killed before


def pids_of_session(session: int) -> list[int]:
    """The processes of a session that are alive."""
    alive = []
    for entry in os.listdir("/proc"):
        try:
            fields = Path("/proc", entry, "stat").read_text().rpartition(")")[2].split()
        except (OSError, ValueError):
            continue
        if fields and int(fields[3]) == session and fields[0] != "Z":
            alive.append(int(entry))
    return alive


def hash_of(data: bytes) -> str:
    """SHA-256, as manifests have it."""
    return hashlib.sha256(data).hexdigest()


def whole(folder: Path) -> bool:
    """Whether a folder holds what its manifest says, and nothing else."""
    try:
        listed = json.loads((folder / "manifest.json").read_bytes())["commands"]
    except (OSError, ValueError):
        return False
    files = {name: digest for own in listed.values() for name, digest in own.items()}
    there = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file() and p.name[0] != "."}
    there.pop("manifest.json")
    return there.keys() == files.keys() and all(
        hash_of(path.read_bytes()) == files[name] for name, path in there.items()
    )


def state(folder: Path) -> dict[str, str]:
    """Hashes of all files below a folder, temporary ones left out."""
    return {
        str(path.relative_to(folder)): hash_of(path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


def killed(words: list[str], number: int, wait: float, environment: dict[str, str], cwd: Path):
    """(exit code, standard error, seconds from signal to end, processes left); code None where it was done before."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        program = [sys.executable, "-m", "valvesim", *words]
        process = subprocess.Popen(
            program, stdin=subprocess.DEVNULL, stdout=out, stderr=err, cwd=cwd, env=environment, start_new_session=True
        )
        try:
            process.wait(wait)
            done = True
        except subprocess.TimeoutExpired:
            done = False
            if number == signal.SIGINT:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
        begin = time.monotonic()
        try:
            process.wait(30.0)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        seconds = time.monotonic() - begin
        left: list[int] = []
        while time.monotonic() - begin < seconds + LATE and (left := pids_of_session(process.pid)):
            time.sleep(0.05)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        err.seek(0)
        lines = [line for line in err.read().decode(errors="replace").splitlines() if not line.startswith("warning: ")]
        return (None if done else process.returncode), lines, seconds, left


def judged(code: int | None, lines: list[str], seconds: float, left: list[int], number: int) -> list[str]:
    """What is wrong with the end of a process."""
    found = []
    right = {None, 0, 128 + number} | (
        {-number} if number == signal.SIGKILL or not lines else set()
    )  # at its very ends
    if code not in right or len(lines) > 1:
        found.append("traceback")
    if seconds > LATE:
        found.append("late")
    if left:
        found.append("child")
    return found

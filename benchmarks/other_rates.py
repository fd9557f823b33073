"""Sessions of the tests' plant at other rates, lengths and noises than the tests draw.

    .venv/bin/python benchmarks/other_rates.py 3200000 50            # healthy valves, by seeds
    .venv/bin/python benchmarks/other_rates.py 3300000 16 --effect   # each with an effect of random strength
    .venv/bin/python benchmarks/other_rates.py 3830000 12 --thinned  # of a bench, every second sample alone
    .venv/bin/python benchmarks/other_rates.py 4000000 8 --command-noise 0.0005  # of the largest command, as measured
    .venv/bin/python benchmarks/other_rates.py 4100000 8 --command-grid 0.001  # the same, as a coarse logger writes

200 Hz to 10 kHz, 0.2 to 5 s, a noise of 0.05 to 3 % of each channel's size. A line for each session: what was hidden,
rate, duration, noise, and the answer. A thinned session is one of tests/bench_plant.py, whose commands go on smoothly
or jump between the samples, logged at half the rate that its chirps and noises were made for. Noise and rounding of the
command are of its instrument: the valve does not feel them.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: a worker is one core
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(ROOT / "tests"))

from bench_plant import (  # noqa: E402
    add_command_noise,
    draw_bench,
    keep_every_second_sample,
    round_commands,
    write_bench_session,
)
from hidden_plant import Case, draw, write_session  # noqa: E402

import valvesim as vs  # noqa: E402

CLOCKS = ((200.0, 5.0), (500.0, 2.0), (1000.0, 1.0), (2000.0, 0.5), (5000.0, 0.4), (10000.0, 0.2), (1000.0, 2.0))
"""Hz and s."""


def diagnosed(seed: int, kind: str) -> tuple[object, ...]:
    """What was hidden in a session, its rate, duration and noise, and the answer with its seconds of processor."""
    dice = random.Random(seed)  # noqa: S311 - no secret
    rate, duration = dice.choice(CLOCKS)
    noise = 10.0 ** dice.uniform(-3.3, -1.5)
    case = draw(seed, kind, noise=noise, rate=rate, duration=duration)
    with tempfile.TemporaryDirectory() as folder:
        write_session(case, folder)
        answer = answer_to(folder)
    return seed, hidden_words(case), f"{rate:g} Hz", f"{duration:g} s", f"{100 * noise:.2g} %", *answer


def thinned(seed: int, kind: str) -> tuple[object, ...]:
    """The same of a session of the bench of which every second sample is kept."""
    case, bench = draw_bench(seed, kind, imperfections=("edges", "ripple", "warming", "skew", "drift"))
    with tempfile.TemporaryDirectory() as folder:
        write_bench_session(case, bench, folder)
        keep_every_second_sample(folder)
        answer = answer_to(folder)
    return seed, hidden_words(case), "500 Hz", *answer


def commanded(seed: int, kind: str, measure: Callable[[str, int], None], told: str) -> tuple[object, ...]:
    """The same of a session of 1 kHz whose commands are measured anew, by its folder and the seed."""
    case = draw(seed, kind)
    with tempfile.TemporaryDirectory() as folder:
        write_session(case, folder)
        measure(folder, seed)
        answer = answer_to(folder)
    return seed, hidden_words(case), told, *answer


def hidden_words(case: Case) -> str:
    return ", ".join(name for name, _ in case.hidden) or "-"


def answer_to(folder: str) -> tuple[str, str]:
    """The answer to the session of a folder, with its seconds of processor."""
    worked = time.process_time()
    try:
        found = vs.diagnose(folder)
        answer = f"{found.verdict}: {', '.join(one.label for one in found.candidates if one.in_set) or '-'}"
    except (vs.InputError, vs.SolveError) as error:
        answer = f"{type(error).__name__}: {error}"
    return answer, f"{time.process_time() - worked:.1f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int)
    parser.add_argument("--effect", action="store_true", help="with an effect hidden in each")
    parser.add_argument("--thinned", action="store_true", help="of a bench, with every second sample alone")
    parser.add_argument("--command-noise", type=float, metavar="SHARE", help="of the largest command, as measured")
    parser.add_argument("--command-grid", type=float, metavar="SHARE", help="of the largest command, as logged")
    given = parser.parse_args()
    drawn = thinned if given.thinned else diagnosed
    if (noise := given.command_noise) is not None:
        drawn = partial(
            commanded, measure=lambda folder, seed: add_command_noise(folder, noise, seed),
            told=f"{100 * noise:g} % on the command",
        )  # fmt: skip
    if (grid := given.command_grid) is not None:
        drawn = partial(
            commanded, measure=lambda folder, seed: round_commands(folder, grid), told=f"command to {100 * grid:g} %"
        )
    for seed in range(given.first, given.first + given.count):
        print(*drawn(seed, "effect" if given.effect else "none"), sep=" | ", flush=True)


if __name__ == "__main__":
    main()

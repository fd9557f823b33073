"""The engine of a study: blocks in this process, on a local Dask cluster, or on any Dask scheduler.

Each block is one task, and one result comes back to the process that leads the study, which alone writes the store; so
workers share no file system, and one that is lost costs its block. A block's result depends on its draws alone, so that
any number of workers gives the same store.
"""

from __future__ import annotations

import contextlib
import logging
import re
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.simulation.batch import cores
from valvesim.studies.criteria import criteria_of
from valvesim.studies.members import BlockResult, StudyPlan, make_plan, run_block, validity_warnings
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.store import StudyStore, open_store, store_bytes
from valvesim.studies.versions import difference, versions
from valvesim.temporary_files import temporary_folder

WORKER_MEMORY = "2GiB"
TASKS_A_WORKER = 2  # in flight, so that none waits for its next
BlockProgress = Callable[[int, int], None]
"""Told (members done, of all)."""


@dataclass(frozen=True)
class Forecast:
    """What a study will take: its members, bytes of its store before compression, seconds of one process for a member
    and for all that is left.
    """

    members: int
    blocks: int
    block_size: int
    bytes: int
    seconds_a_member: float

    def seconds(self, workers: int) -> float:
        """Of the whole study on so many workers."""
        return self.members * self.seconds_a_member / min(workers, self.blocks)


def forecast(study: ParameterStudy, *, seconds: float = 3.0) -> Forecast:
    """Time a few members, twice as many each time until so many seconds are spent. Nothing is written."""
    plan = make_plan(study)
    draws = study.draws()[: study.block_size]
    count, spent = min(2, len(draws)), 0.0
    while True:
        begin = time.perf_counter()
        run_block(study, plan, 0, draws[:count])
        took = time.perf_counter() - begin
        spent += took
        if spent > seconds or count == len(draws):
            size = store_bytes(study, plan)
            return Forecast(study.members, study.blocks, study.block_size, size, took / count)
        count = min(2 * count, len(draws))


def run_study(
    study: ParameterStudy, folder: Path, *, workers: int | None = None, scheduler: str | None = None,
    progress: BlockProgress | None = None,
) -> None:  # fmt: skip
    """Run every block that the store in `folder` does not have yet; the store may be one that was begun before.

    `workers` processes on this machine (all cores; 0: this process alone), or the workers of the Dask `scheduler` at an
    address such as "tcp://host:8786". Raises InputError for the store of another study, a scheduler that cannot be
    reached and a worker of another version; SolveError where workers keep dying.
    """
    with validity_warnings() as warned:
        plan = make_plan(study)
    criteria_of(plan.figures, plan.nominal, study.limits, study.specification)  # what makes no sense is told now
    told: set[str] = set()
    with contextlib.ExitStack() as stack:
        client = None if scheduler is None else stack.enter_context(_served(scheduler))  # before anything is written
        store = open_store(Path(folder), study, plan)
        pending = store.pending
        done, count = study.members - _members(store, pending), study.members
        if progress is not None:
            progress(done, count)
        _warn(warned, told)
        if client is None and workers != 0 and pending:
            client = stack.enter_context(_local(min(workers or cores(), len(pending))))
        for result in _results(client, study, plan, store, pending):
            store.write(result)
            _warn(result.warnings, told)
            done += len(result.figures)
            if progress is not None:
                progress(done, count)


def _warn(messages: Iterable[str], told: set[str]) -> None:
    """Give the validity warnings of members, of this process or a worker, that have not been given."""
    for message in messages:
        if message not in told:
            told.add(message)
            warnings.warn(message, ValidityWarning, stacklevel=3)


def _members(store: StudyStore, blocks: list[int]) -> int:
    regions = [store.region(block) for block in blocks]
    return sum(region.stop - region.start for region in regions)


@contextlib.contextmanager
def _served(scheduler: str) -> Iterator[Any]:
    """A client of the Dask scheduler at an address. InputError where there is none, or none of its workers will do."""
    distributed = _distributed()
    place = re.fullmatch(r"(?:\w+://)?[^/\s:]+:(\d{1,5})", scheduler)
    if place is None or int(place[1]) > 65535:  # which Dask would wait for
        raise InputError(f"{scheduler!r} is no address such as tcp://host:8786", key="scheduler")
    try:
        client = distributed.Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no Dask scheduler at {scheduler!r} ({error})", key="scheduler") from None
    with client:
        check_workers(client)
        yield client


@contextlib.contextmanager
def _local(workers: int) -> Iterator[Any]:
    """A client of a Dask cluster of so many processes, which ends with it."""
    distributed = _distributed()
    with (
        temporary_folder(Path(tempfile.gettempdir()), "valvesim-study-") as scratch,
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, memory_limit=WORKER_MEMORY,
            local_directory=scratch, silence_logs=logging.ERROR,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "Dask is not installed: pip install 'valvesim[fleet]', or workers = 0 for one process alone", key="workers"
        ) from None
    return distributed


def _results(
    client: Any, study: ParameterStudy, plan: StudyPlan, store: StudyStore, pending: list[int]
) -> Iterator[BlockResult]:  # fmt: skip
    """The results of blocks as they come: from the workers of a client, a few blocks in flight, or of this process."""
    if client is None:
        for block in pending:
            yield run_block(study, plan, block, store.draws(block))
        return
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    own, queue = versions(), iter(pending)

    def submit(block: int) -> Any:
        return client.submit(checked_block, own, study, plan, block, store.draws(block), pure=False)

    workers = max(len(client.scheduler_info(n_workers=-1)["workers"]), 1)
    begun = [submit(block) for _, block in zip(range(TASKS_A_WORKER * workers), queue, strict=False)]
    running = as_completed(begun, loop=client.loop)
    for future in running:
        try:
            result = future.result()
        except KilledWorker as error:
            raise SolveError(
                f"workers died one after the other at one block ({error}); less memory is taken by a smaller "
                "block, what is done is kept"
            ) from None
        future.release()
        for block in (block for _, block in zip(range(1), queue, strict=False)):
            running.add(submit(block))
        yield result


def checked_block(
    own: dict[str, str], study: ParameterStudy, plan: StudyPlan, block: int, draws: Any
) -> BlockResult:  # fmt: skip
    """`run_block` on a worker. InputError where it has other versions than the process that leads the study."""
    if told := difference(own, versions()):
        raise InputError(f"a worker has {told}; give all the same", key="scheduler")
    return run_block(study, plan, block, draws)


def check_workers(client: Any) -> None:
    """InputError where there is no worker, or one has no valvesim or other versions than this process."""
    own, answers = versions(), client.run(versions, on_error="return")
    if not answers:
        raise InputError("the scheduler has no worker; start one: dask worker ADDRESS --nthreads 1", key="scheduler")
    for address, told in answers.items():
        if isinstance(told, BaseException):
            raise InputError(f"worker {address} cannot run a study: {told!r}", key="scheduler")
        if differs := difference(own, told):
            raise InputError(f"worker {address} has {differs}; give all the same", key="scheduler")

"""A study run and read: the one call that does both."""

from __future__ import annotations

from pathlib import Path

from valvesim.studies.engine import BlockProgress, run_study
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.study_result import StudyResult, open_result
from valvesim.studies.study_toml import load_study


def study(
    source: ParameterStudy | str | Path, folder: str | Path, *, workers: int | None = None,
    scheduler: str | None = None, progress: BlockProgress | None = None,
) -> StudyResult:  # fmt: skip
    """Run a study, or go on with one that was begun in `folder`, and open its result.

    `source` is a study or the name of its file. The members run on `workers` processes of this machine (all cores by
    default, 0: this process alone), or on those of the Dask `scheduler` at an address; any number gives the same store.
    Raises InputError for what makes no sense, and as `engine.run_study` does; what has run stays in the folder.
    """
    own = source if isinstance(source, ParameterStudy) else load_study(source)
    run_study(own, Path(folder), workers=workers, scheduler=scheduler, progress=progress)
    return open_result(own, Path(folder))

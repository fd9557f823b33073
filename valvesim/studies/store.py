"""The store of a study: Zarr arrays by blocks of members. The template is written once, then each block its region.

A block has its flag in `done` when all of its arrays are written: what a kill left half-written is written again, and
the store ends the same byte for byte. One process writes, the one that leads the study. Format 2 of Zarr: text of a
fixed length has no settled form in format 3.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.io import reason
from valvesim.studies.channel_histogram import BINS
from valvesim.studies.members import LONGEST_REASON, BlockResult, StudyPlan
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.versions import difference, versions
from valvesim.temporary_files import made_folder, temporary_path

STORE_NAME = "study.zarr"  # the store in the folder of a study
FORMAT = 1  # of what stands in it
DRAWS_ARRAY, FIGURES_ARRAY, REASONS_ARRAY, DONE_ARRAY = "draw", "figure", "reason", "done"
COUNTS_ARRAY, LOWEST_ARRAY, HIGHEST_ARRAY = "counts", "lowest", "highest"
WHOLE_ARRAY, TIME_ARRAY = "whole", "time"


class StudyStore:
    """An open store: which blocks are done, the draws of a block, and writing its result."""

    def __init__(self, group: Any, study: ParameterStudy):
        self.group, self.study = group, study

    @property
    def pending(self) -> list[int]:
        """Numbers of the blocks that are not done."""
        try:
            return [int(k) for k in np.flatnonzero(~np.asarray(self.group[DONE_ARRAY][:]))]
        except Exception as error:  # a codec has errors of many kinds for what it did not write
            problem = f"array {DONE_ARRAY!r} cannot be read ({error}): the store is damaged; remove it and run again"
            raise InputError(problem) from None

    def draws(self, block: int) -> np.ndarray:
        """Draws (k, variables) of the members of a block."""
        return np.asarray(self.group[DRAWS_ARRAY][self.region(block)])

    def region(self, block: int) -> slice:
        """The members of a block."""
        size = self.study.block_size
        return slice(block * size, min((block + 1) * size, self.study.members))

    def write(self, result: BlockResult) -> None:
        """Write a block, its flag last."""
        group, region = self.group, self.region(result.number)
        group[FIGURES_ARRAY][region] = result.figures
        group[REASONS_ARRAY][region] = np.array([_bytes(text) for text in result.reasons], dtype=f"S{LONGEST_REASON}")
        if self.study.percentiles is not None:
            group[COUNTS_ARRAY][result.number] = result.counts
            group[LOWEST_ARRAY][result.number] = result.lowest
            group[HIGHEST_ARRAY][result.number] = result.highest
        if self.study.whole is not None:
            places = {number: k for k, number in enumerate(self.study.whole.members)}
            for number, values in result.whole.items():
                group[WHOLE_ARRAY][places[number]] = values
        group[DONE_ARRAY][result.number] = True


def open_store(folder: Path, study: ParameterStudy, plan: StudyPlan) -> StudyStore:
    """The store of a study in a folder: a new one, or the one that was begun there.

    Raises InputError where it is of another study, unfinished and of another version of the package, or cannot be
    written; then nothing is changed.
    """
    import zarr

    path = folder / STORE_NAME
    if not path.exists():
        _create(path, study, plan)
    try:
        group = zarr.open_group(path, mode="r+", zarr_format=2)
        attributes: dict[str, Any] = dict(group.attrs)
    except Exception as error:  # zarr has errors of many kinds for what is no store
        raise InputError(f"is no store of a study ({error})", file=path) from None
    check_identity(path, attributes, study)
    store = StudyStore(group, study)
    if store.pending and (told := difference(attributes["versions"], versions())):
        raise InputError(
            f"was begun with other versions: here {told}; finish it with those, or start in another folder", file=path
        )  # fmt: skip
    return store


def check_identity(path: Path, attributes: dict[str, Any], study: ParameterStudy) -> None:
    """InputError unless the attributes are those of a store of this study."""
    if attributes.get("format") != FORMAT or "identity" not in attributes:
        raise InputError("is no store of a study", file=path)
    if attributes["identity"] != study.identity():
        title = attributes.get("title", "")
        raise InputError(
            f"holds another study ({title!r}, {attributes.get('members')} members, seed {attributes.get('seed')}); "
            "choose another folder, or run that study to go on with it", file=path,
        )  # fmt: skip


def _create(path: Path, study: ParameterStudy, plan: StudyPlan) -> None:
    """Write the template beside its place and move it there whole, so that a kill leaves none or all of it."""
    import zarr

    try:
        with made_folder(path.parent), temporary_path(path.parent, f".{path.name}-") as new:
            group: Any = zarr.open_group(new, mode="w", zarr_format=2)
            group.attrs.update(attributes_of(study, plan))
            _add_arrays(group, study, plan)
            draws = study.draws()
            for start in range(0, study.members, study.block_size):
                group[DRAWS_ARRAY][start : start + study.block_size] = draws[start : start + study.block_size]
            if len(plan.times):
                group[TIME_ARRAY][:] = plan.times
            new.rename(path)
    except OSError as error:
        raise InputError(f"cannot be written ({reason(error)})", file=path) from None


def _add_arrays(group: Any, study: ParameterStudy, plan: StudyPlan) -> None:
    members, block, nan = study.members, study.block_size, float("nan")

    def add(name: str, dimensions: str, shape: tuple[int, ...], chunks: tuple[int, ...], dtype: Any, fill: Any) -> None:
        one = group.create_array(name, shape=shape, chunks=chunks, dtype=dtype, fill_value=fill)
        one.attrs["_ARRAY_DIMENSIONS"] = dimensions.split()

    variables, figures = len(study.variables), len(plan.figures)
    add(DRAWS_ARRAY, "member parameter", (members, variables), (block, variables), "f8", nan)
    add(FIGURES_ARRAY, "member figure", (members, figures), (block, figures), "f8", nan)
    add(REASONS_ARRAY, "member", (members,), (block,), f"S{LONGEST_REASON}", b"")
    add(DONE_ARRAY, "block", (study.blocks,), (1,), bool, False)
    if len(plan.times):
        add(TIME_ARRAY, "time", plan.times.shape, plan.times.shape, "f8", nan)
    if study.percentiles is not None:
        shape = (len(study.percentiles.channels), len(plan.samples))
        add(COUNTS_ARRAY, "block channel sample bin", (study.blocks, *shape, BINS), (1, *shape, BINS), "u4", 0)
        for name, fill in ((LOWEST_ARRAY, np.inf), (HIGHEST_ARRAY, -np.inf)):
            add(name, "block channel sample", (study.blocks, *shape), (1, *shape), "f8", fill)
    if study.whole is not None:
        shape = (len(study.whole.channels), len(plan.times))
        add(WHOLE_ARRAY, "kept_member whole_channel time", (len(study.whole.members), *shape), (1, *shape), "f8", nan)


def attributes_of(study: ParameterStudy, plan: StudyPlan) -> dict[str, Any]:
    """What stands in the store's attributes: enough to read it without the study."""
    channels = {channel.name: channel for channel in study.channels}
    told: dict[str, Any] = {
        "format": FORMAT, "identity": study.identity(), "title": study.title, "versions": versions(),
        "members": study.members, "block_size": study.block_size, "design": study.design.kind,
        "base_samples": study.design.members, "seed": study.design.seed,
        "parameters": [
            {"key": v.key, "unit": v.quantity.unit, "doc": v.quantity.doc, "nominal": v.quantity.nominal,
             "distribution": v.distribution.words} for v in study.variables
        ],
        "figures": [
            {"name": f.name, "unit": f.unit, "doc": f.doc, "nominal": _number(n)}
            for f, n in zip(plan.figures, plan.nominal, strict=True)
        ],
    }  # fmt: skip
    if study.percentiles is not None and plan.reference is not None:
        told["percentiles"] = {
            "channels": [{"name": name, "unit": channels[name].unit} for name in study.percentiles.channels],
            "levels": list(study.percentiles.levels), "samples": plan.samples.tolist(),
            "nominal": plan.reference.values.tolist(), "spans": plan.reference.spans.tolist(),
        }  # fmt: skip
    if study.whole is not None:
        told["whole"] = {
            "members": list(study.whole.members),
            "channels": [{"name": name, "unit": channels[name].unit} for name in study.whole.channels],
        }
    return json.loads(json.dumps(told))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _bytes(text: str) -> bytes:
    """Text as UTF-8 of at most `LONGEST_REASON` bytes, no letter cut in two."""
    return text.encode()[:LONGEST_REASON].decode(errors="ignore").encode()


def store_bytes(study: ParameterStudy, plan: StudyPlan) -> int:
    """Bytes of the store's arrays before compression."""
    members, per_member = study.members, 8 * (len(study.variables) + len(plan.figures)) + LONGEST_REASON
    counts = study.blocks * len(plan.samples) * (BINS * 4 + 16)
    counts *= len(study.percentiles.channels) if study.percentiles is not None else 0
    whole = 8 * len(plan.times) * len(study.whole.members) * len(study.whole.channels) if study.whole else 0
    return members * per_member + counts + whole

"""What a run gave: every state, signal, input and temperature over time, and writing it: netCDF, CSV, Parquet, MAT."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, Channel
from valvesim.errors import InputError, unknown_name
from valvesim.io import write_atomically, write_columns
from valvesim.shown import Shown, notebook
from valvesim.simulation.scenario import Scenario
from valvesim.units import DISPLAY
from valvesim.valve.coefficients import PART_NAMES
from valvesim.valve.valve_name import valve_name
from valvesim.version import package_version


@dataclass(frozen=True, repr=False)
class Result(Shown):
    """What a run gave: `result["spool_position"]` is an xarray.DataArray over time, with its unit in `attrs["units"]`.

    Names: every state, every signal, the inputs, and `<part>_temperature` of oil and parts (°C). SI throughout.
    `values[name]` is the bare array (n_t,), `time` the samples' times in s.
    """

    scenario: Scenario
    time: np.ndarray
    channels: tuple[Channel, ...]
    values: dict[str, np.ndarray]
    statistics: dict[str, float]

    def __getitem__(self, name: str) -> Any:
        return self.select((name,)).dataset[name]

    def in_words(self) -> str:
        """Title, how much there is of it, and the valve."""
        what = f"{len(self.channels)} channels of {len(self.time)} samples over {self.scenario.duration:g} s"
        return f"{self.scenario.title!r}, {what}, {valve_name(self.scenario.valve)}"

    @property
    def names(self) -> tuple[str, ...]:
        """All channels, in order."""
        return tuple(channel.name for channel in self.channels)

    @property
    def dataset(self) -> Any:
        """All channels as one xarray.Dataset with units."""
        import xarray

        return xarray.Dataset(
            {
                channel.name: ("time", self.values[channel.name], {"units": channel.unit, "long_name": channel.doc})
                for channel in self.channels
            },
            coords={"time": ("time", self.time, {"units": "s", "long_name": "time"})},
            attrs=self._attributes(),
        )

    def display(self, name: str) -> tuple[np.ndarray, str]:
        """(values, unit) of a channel as people read it: mm, bar, mA, L/min."""
        (channel,) = self.select((name,)).channels
        unit, factor = DISPLAY.get(channel.unit, (channel.unit, 1.0))
        return self.values[name] * factor, unit

    def to_pandas(self) -> Any:
        """All channels as a pandas.DataFrame over time in s, a column each, SI."""
        return self.dataset.to_dataframe()

    def plot(self, *names: str) -> Any:
        """A matplotlib figure of these channels over time, or of the whole run. InputError for a wrong name."""
        return notebook().plot(self, names)

    def bode(self, output: str = "spool_position") -> Any:
        """A matplotlib figure of the frequency response of a channel to the command; the run is of a chirp or noise.

        Raises InputError as `spectral_response`, where the command excites too little.
        """
        return notebook().bode(self, output)

    def select(self, names: Sequence[str]) -> Result:
        """The result with these channels alone; all of them if none is named. InputError for an unknown name."""
        for name in names:
            if name not in self.values:
                raise unknown_name("channel", name, self.names)
        return replace(self, channels=tuple(c for c in self.channels if c.name in names)) if names else self

    def to_csv(self, path: str | Path) -> Path:
        """Write all channels, one column each with its unit in the header (mm, bar, mA, L/min). Returns the path."""
        columns = {"time [s]": self.time}
        for name in self.names:
            values, unit = self.display(name)
            columns[f"{name} [{unit}]"] = values
        return write_columns(Path(path), columns)

    def to_netcdf(self, path: str | Path) -> Path:
        """Write all channels as netCDF-4 (HDF5): labelled arrays with units that Python, MATLAB and others open."""

        def write(temporary: Path) -> None:
            from netCDF4 import Dataset

            with Dataset(temporary, "w") as file:
                file.setncatts(self._attributes())
                file.createDimension("time", len(self.time))
                for channel in (Channel("time", "s", "time"), *self.channels):
                    variable = file.createVariable(channel.name, "f8", ("time",), compression="zlib", complevel=1)
                    variable.setncatts({"units": channel.unit, "long_name": channel.doc})
                    variable[:] = self.time if channel.name == "time" else self.values[channel.name]

        return write_atomically(Path(path), write)

    def to_parquet(self, path: str | Path) -> Path:
        """Write all channels as Parquet, units in the fields' metadata. InputError where pyarrow is not installed."""
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError:
            raise InputError("Parquet files need pyarrow: pip install 'valvesim[parquet]'", file=path) from None
        channels = (Channel("time", "s", "time"), *self.channels)
        fields = [
            pyarrow.field(c.name, pyarrow.float64(), metadata={"units": c.unit, "long_name": c.doc}) for c in channels
        ]
        schema = pyarrow.schema(fields, metadata=self._attributes())
        table = pyarrow.table([self.time, *(self.values[c.name] for c in self.channels)], schema=schema)
        return write_atomically(Path(path), lambda temporary: pyarrow.parquet.write_table(table, temporary))

    def to_mat(self, path: str | Path) -> Path:
        """Write all channels as MATLAB variables (version 5, columns), with structures `units` and `about`."""

        def write(temporary: Path) -> None:
            from scipy.io import savemat

            columns = {"time": self.time} | {c.name: self.values[c.name] for c in self.channels}
            units = {"time": "s"} | {c.name: c.unit for c in self.channels}
            content = {**columns, "units": units, "about": self._attributes()}
            savemat(temporary, content, do_compression=True, oned_as="column", appendmat=False, long_field_names=True)

        return write_atomically(Path(path), write)

    def _attributes(self) -> dict[str, str]:
        scenario = self.scenario
        given = {
            "title": scenario.title, "source": f"valvesim {package_version()}", "date": date.today().isoformat(),
            "valve": valve_name(scenario.valve), "oil": scenario.oil.name, "tolerance": f"{scenario.tolerance:g}",
        }  # fmt: skip
        with contextlib.suppress(InputError):  # what no file can say
            given["scenario"] = scenario.to_toml()
        return given


def output_channels(scenario: Scenario) -> tuple[Channel, ...]:
    """The channels of a result, in order."""
    return (
        *scenario.drive.command_channels,
        *(Channel(f"{name}_temperature", "degC", name.replace("_", " ")) for name in PART_NAMES),
        *INPUT_CHANNELS[2:],
        *scenario.model.state_channels,
        *SIGNAL_CHANNELS,
    )


def check_channels(scenario: Scenario) -> None:
    """InputError for a name in `scenario.channels` that no result has."""
    names = [channel.name for channel in output_channels(scenario)]
    for name in scenario.channels:
        if name not in names:
            raise unknown_name("channel", name, names, "outputs.channels")

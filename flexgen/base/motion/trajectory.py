"""Trajectories: named channels over one time grid, saved as npz or csv without loss."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, KeysView, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError, ChannelError
from flexgen.base.files import trajectory_files
from flexgen.base.results import Result
from flexgen.base.spec.ports import Port

# channels of joints, whose unit can be that of all: "rad or m"
OF_JOINTS = ("q_a", "v_a", "a_a")


@checked_result
@dataclass(frozen=True, repr=False)
class Trajectory(Result):
    """Channels sampled on one time grid.

    ``trajectory["tau_m"]`` is a channel, ``trajectory.keys()`` are the names of all channels.
    Another name raises ChannelError, a KeyError.

    Parameters
    ----------
    time : array, shape (n,) [s]
        Strictly increasing.
    channels : mapping from name to array, shape (n, width)
    ports : mapping from name to Port
        Shape ``(width,)``, unit and meaning of each channel.
    labels : mapping from name to tuple of str
        One label for each column (the name of the coordinate or motor).
    meta : dict
        JSON types only: ``model``, ``variant``, ``move``, ``kind``; ``torque`` is ``"limited"``
        where limits may be active and an interpolation must not exceed them; ``torque_degree``:
        the torque is a polynomial of this degree on each ten samples and may jump between them.
    units : mapping from name to tuple of str, optional
        Unit of each column where the columns of a channel differ; the unit of the port is then
        ``"rad or m"``.

    Examples
    --------
    >>> trajectory = flexgen.solve("elbow").trajectory
    >>> trajectory["tau_m"].shape, trajectory.labels["tau_m"]
    ((1005, 2), ('m1', 'm2'))
    >>> file = trajectory.save("line.csv")
    >>> flexgen.Trajectory.load(file).at(0.5)["tau_m"].round(2)
    array([-5.05, -6.43])
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    ports: Mapping[str, Port]
    labels: Mapping[str, tuple[str, ...]]
    meta: dict[str, Any] = field(default_factory=dict)
    units: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.time) if np.ndim(self.time) == 1 else 0
        if n < 2 or not np.isfinite(self.time).all() or not np.all(np.diff(self.time) > 0):
            raise ArgumentError(
                "trajectory: given a time grid that does not increase, expected at least 2 "
                "increasing instants"
            )
        if not self.ports.keys() == self.channels.keys() == self.labels.keys():
            raise ArgumentError(
                "trajectory: given channels, ports and labels with different names, expected "
                "the same names"
            )
        for name, port in self.ports.items():
            if len(self.labels[name]) != port.size:
                raise ArgumentError(
                    f"trajectory channel {name}: given {len(self.labels[name])} labels, "
                    f"expected {port.size}"
                )
            shape = np.shape(self.channels[name])
            if shape != (n, *port.shape):
                raise ArgumentError(
                    f"trajectory channel {name}: given shape {shape}, expected {(n, *port.shape)}"
                )
        units = {}
        for name, port in self.ports.items():
            given = tuple(self.units.get(name, ()))
            fits = given and trajectory_files.common_unit(given) == port.unit
            units[name] = given if fits else (port.unit,) * port.size
            if len(units[name]) != port.size:
                raise ArgumentError(
                    f"trajectory channel {name}: given {len(given)} units, expected {port.size}"
                )
        object.__setattr__(self, "units", units)

    def __repr__(self) -> str:
        t = self.time
        of = f" {self.meta['model']}" if self.meta.get("model") else ""
        return (
            f"<Trajectory{of}: {len(t)} samples from {t[0]:.4g} to {t[-1]:.4g} s, "
            f"{' '.join(self.channels)}>"
        )

    def keys(self) -> KeysView[str]:
        """Names of the channels."""
        return self.channels.keys()

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            return self.channels[name]
        except (KeyError, TypeError):
            near = (
                difflib.get_close_matches(name, self.channels, 1) if isinstance(name, str) else []
            )
            meant = (
                f"{near[0]} (there are: {', '.join(self.channels)})"
                if near
                else f"one of {', '.join(self.channels)}"
            )
            time = "; the time is the attribute .time" if name in ("t", "time") else ""
            raise ChannelError(
                f"trajectory channel: given {name!r}, expected {meant}{time}"
            ) from None

    def columns(self) -> list[str]:
        """Names of all scalars in the order of the channels: ``name[label] unit``."""
        return trajectory_files.column_names(self.labels, self.units)

    def at(self, t: Any) -> dict[str, np.ndarray]:
        """All channels at other instants, by the curves that `flexgen.simulate` and the
        verification use.

        Motor torques: the quintic spline through the samples; where limits may be active, the
        polynomials that were sampled. Coordinates and motor angles: the quintic Hermite
        polynomials through the samples of angle, speed and acceleration; their speeds and
        accelerations are the derivatives of these polynomials. Other channels: quintic splines.

        Parameters
        ----------
        t : float or array (k,) [s]
            Within the time of the trajectory.

        Returns
        -------
        dict
            Each channel with shape (width,), or (k, width) for an array.

        Raises
        ------
        ArgumentError
            An instant is outside of the trajectory.
        """
        from flexgen.base.motion.interpolation import interpolate

        return interpolate(self.time, self.channels, self.meta, t)

    def to_dataframe(self) -> Any:
        """The trajectory as a table of the package pandas.

        Returns
        -------
        pandas.DataFrame
            One column per scalar, named ``name[label] unit``; the index is the time [s].

        Raises
        ------
        ArgumentError
            The package pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise ArgumentError(
                "to_dataframe: the package pandas is not installed; run: pip install pandas"
            ) from None
        table = np.column_stack([self.channels[name] for name in self.ports])
        return pandas.DataFrame(
            table, index=pandas.Index(self.time, name="time s"), columns=self.columns()
        )

    def to_xarray(self) -> Any:
        """The trajectory as a data set of the package xarray.

        Returns
        -------
        xarray.Dataset
            A variable for each channel over ``time`` [s] and the labels of its columns, whose
            dimension is ``NAME_column``. ``attrs`` of a variable: ``units`` (one text, or a list
            where the columns differ) and ``long_name``; of the dataset: the meta data.

        Raises
        ------
        ArgumentError
            The package xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise ArgumentError(
                "to_xarray: the package xarray is not installed; run: pip install xarray"
            ) from None
        variables = {}
        columns = {}
        for name, port in self.ports.items():
            units = self.units[name]
            unit = units[0] if len(set(units)) == 1 else list(units)
            variables[name] = (
                ("time", f"{name}_column"),
                self.channels[name],
                {"units": unit, "long_name": port.doc},
            )
            columns[f"{name}_column"] = list(self.labels[name])
        time = ("time", self.time, {"units": "s"})
        return xarray.Dataset(variables, coords={"time": time, **columns}, attrs=dict(self.meta))

    def save(self, path: str | Path) -> Path:
        """Write to ``path``: ``.npz`` with all data, ``.csv`` with a column for each scalar,
        ``name[label] unit``.

        ``.mat``: for MATLAB and Octave, which `load` does not read: ``time`` (n, 1), the channels
        (n, width), the structures ``labels`` and ``units`` with the names and units of their
        columns, and ``meta`` in JSON.

        The file is complete or as it was before, whatever happens (a full disk, a killed process).
        ArgumentError where it cannot be written.
        """
        path = Path(path)
        trajectory_files.write(
            path, self.time, self.channels, self.ports, self.labels, self.meta, self.units
        )
        return path

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a file that `save` wrote; ArgumentError where the file is not a trajectory or was
        cut.
        """
        path = Path(path)
        content = trajectory_files.read(path)
        try:
            return Trajectory(**vars(content))
        except ArgumentError as error:
            raise ArgumentError(f"{path}: {error}") from None


def channel_values(
    where: str, data: Trajectory, name: str, units: Mapping[str, str]
) -> np.ndarray:
    """A channel of a trajectory in SI units, its columns in the order of their labels.

    Parameters
    ----------
    where : str
        For the error.
    data : Trajectory
    name : str
        Of the channel.
    units : mapping from label to SI unit
        Of the columns that are wanted: a channel has these and no others.

    Returns
    -------
    array (n, labels)

    Raises
    ------
    ArgumentError
        The channel is missing or has other columns; a unit is not known or of another kind; a
        number is not finite.
    """
    from flexgen.base.spec.units import conversion

    labels = list(units)
    given = data.labels[name] if name in data else ()
    if name not in data:
        raise ArgumentError(
            f"{where}: given the channels {', '.join(data)}, expected also {name} of "
            f"{', '.join(labels)}"
        )
    if len(given) != len(labels):
        raise ArgumentError(
            f"{where}: given {len(given)} columns of {name}, expected {len(labels)}: "
            f"{', '.join(labels)}; take the model that it was written for"
        )
    if sorted(given) != sorted(labels):
        raise ArgumentError(
            f"{where} channel {name}: given columns {', '.join(given)}, expected "
            f"{', '.join(labels)}; take the model that it was written for"
        )
    factors = []
    for label, unit in zip(given, data.units[name], strict=True):
        mixed = name in OF_JOINTS and units[label] in unit.split(" or ")
        same = unit == units[label] or mixed
        at = f"{where} channel {name}, column {label}"
        factors.append(1.0 if same else conversion(at, unit, units[label]))
    values = np.asarray(data[name], dtype=float)
    if not np.isfinite(values).all():
        raise ArgumentError(
            f"{where} channel {name}: given NaN or infinity, expected finite numbers"
        )
    order = [given.index(label) for label in labels]
    if factors != [1.0] * len(factors):
        values = values * factors
    return values if order == list(range(len(order))) else values[:, order]


def convert_to_si(
    where: str, data: Trajectory, wanted: Mapping[str, Mapping[str, str]]
) -> Trajectory:
    """A trajectory whose channels are in SI units; the same object where they are.

    Parameters
    ----------
    where : str
        For the error.
    data : Trajectory
    wanted : mapping
        Name of a channel -> label -> SI unit. Channels with other labels stay as they are.

    Raises
    ------
    ArgumentError
        A unit is not known or of another kind.
    """
    channels = dict(data.channels)
    labels = dict(data.labels)
    ports = dict(data.ports)
    units = dict(data.units)
    for name, own in wanted.items():
        if name not in data or sorted(data.labels[name]) != sorted(own):
            continue
        stated = zip(data.labels[name], data.units[name], strict=True)
        if all(unit == own[label] or " or " in unit for label, unit in stated):
            continue
        channels[name] = channel_values(where, data, name, own)
        labels[name] = tuple(own)
        units[name] = tuple(own.values())
        unit = trajectory_files.common_unit(units[name])
        ports[name] = Port(name, (len(own),), unit, data.ports[name].doc)
    if all(channels[name] is data.channels[name] for name in channels):
        return data
    return Trajectory(data.time, channels, ports, labels, data.meta, units)

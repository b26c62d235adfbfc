"""From a directory to a library whose functions can be called: `load` compares what is there with
its manifest.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from flexgen.base import errors, registry
from flexgen.base.checks.type_checks import checked_methods, checked_types
from flexgen.base.errors import ArgumentError, BuildError, FlexgenError
from flexgen.base.spec.ports import Port, c_name_problem
from flexgen.runtime.arguments import PARAMETERS
from flexgen.runtime.calls import Entries, Function
from flexgen.runtime.files import AGAIN, load_verified
from flexgen.runtime.identity import REALS, entry_of, read_manifest, read_parameters, verify
from flexgen.runtime.inversion.growth import Growth, growth_of
from flexgen.runtime.inversion.inverse_kinematics import InverseKinematics, inverse_kinematics_of
from flexgen.runtime.inversion.limited_inversion import LimitedInverter
from flexgen.runtime.inversion.many_inversion import ManyInverter
from flexgen.runtime.inversion.path_inversion import Inverter, inverter_of
from flexgen.runtime.inversion.targets import refuse_other_computer
from flexgen.runtime.streams.path_sampler import PathSampler, SamplerEntries, samplers_of
from flexgen.runtime.streams.stream import Stream
from flexgen.runtime.streams.stream_entries import StreamEntries, streams_of
from flexgen.runtime.structs import Failures, closed_error

_LIBRARY_FILE = re.compile(
    r"lib(?P<name>[A-Za-z][A-Za-z0-9_]*)-(?P<hash>[0-9a-f]{16})\.(so|dylib|dll)\Z"
)
_INVERTERS = {"invert": Inverter, "bvp": Inverter, "invert_limited": LimitedInverter}
_INVERTS = (
    "one with all functions, of a model with as many outputs as motors and simplified motor "
    "coupling"
)


@checked_methods
class Library:
    """A loaded library: its functions are attributes, such as ``library.mass_matrix(q_a)``.

    It may be used by several threads, copied (a copy is the same library), pickled (it is loaded
    again from its directory, and refused where another one is there now) and closed, by hand or as
    a context manager. Closing makes every later call an error, and every later update of its
    streams; the code stays in memory until the process ends, so that calls under way in other
    threads end well.

    Parameters
    ----------
    name : str
        The model's name, with its variant.
    directory : Path
        Where it was loaded from.
    digest : str
        SHA-256 of the model's data, as the library itself says.
    precision : str
        ``"double"`` or ``"single"``.
    functions : mapping of str to Function
        By name, in the order of the header.
    sizes : mapping of str to int
        ``n_a``, ``n_g``, ``n_e``, ``n_m``, ``n_x``; ``n_y``, ``n_t`` (outputs, and numbers of a
        target of them) where the model has as many outputs as motors; ``n_s`` with sensors;
        ``n_p`` with run-time parameters.
    parameters : ndarray
        Values of the run-time parameters in the model file, which calls use where they are given
        no others; read-only.
    parameter_names : tuple of str
        What they are, in the same order; with ``per_point`` batches take them for each point.
    coordinates, units, motors, states : tuple of str
        Names and units of ``q_a``, names of ``q_m``, meaning of the state of ``linearize``.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow").directory)
    >>> library.mass_matrix([0.0, 0.0]).shape
    (2, 2)
    >>> path = flexgen.plan("elbow", "line")
    >>> y, dy, ddy = path.sample([0.005 * k for k in range(201)]).y.transpose(2, 0, 1)[:3]
    >>> library.invert(y, dy, ddy, period=0.005, q_start=path.q_start).tau_m.shape  # N m
    (201, 2)
    """

    def __init__(
        self,
        directory: Path,
        manifest: dict[str, Any],
        functions: dict[str, Function],
        parameters: np.ndarray,
        inverters: Mapping[str, Inverter | None] | None = None,
        streams: StreamEntries | None = None,
        samplers: SamplerEntries | None = None,
        inverse_kinematics: InverseKinematics | None = None,
    ) -> None:
        self.name: str = manifest["name"]
        self.directory = directory
        self.digest: str = manifest["model_digest"]
        self.precision: str = manifest.get("precision", "double")
        self.functions: Mapping[str, Function] = MappingProxyType(functions)
        self.sizes: Mapping[str, int] = MappingProxyType(dict(manifest["sizes"]))
        self.parameters = parameters
        self.per_point: bool = bool(manifest.get("per_point"))
        self.parameter_names: tuple[str, ...] = tuple(
            p["name"] for p in manifest.get("parameters", ())
        )
        self.coordinates: tuple[str, ...] = tuple(c["name"] for c in manifest["coordinates"])
        self.units: tuple[str, ...] = tuple(c["unit"] for c in manifest["coordinates"])
        self.motors: tuple[str, ...] = tuple(manifest["motors"])
        self.states: tuple[str, ...] = tuple(manifest["states"])
        self._again = (str(directory.resolve()), manifest["build"]["sha256"])
        self._inverters = dict(inverters or {})
        self.streams = streams
        self.samplers = samplers
        self._inverse_kinematics = inverse_kinematics
        self._closed = False
        self._growth: Growth | None = None

    @property
    def inverse_kinematics(self) -> InverseKinematics:
        """All joint configurations at a pose; ArgumentError where the library has none."""
        if self._inverse_kinematics is None:
            raise ArgumentError(
                f"{self.name}: given a library without inverse_kinematics, expected one in "
                "double precision with forward_kinematics and jacobian, of an arm with at "
                "least six motors, without per_point"
            )
        return self._inverse_kinematics

    @property
    def invert(self) -> Inverter:
        """Inverse dynamics along whole paths; ArgumentError where the library has none."""
        return self._inverter("invert", _INVERTS)

    @property
    def invert_many(self) -> ManyInverter:
        """Inverter of many problems on all cores; ArgumentError where the library has none."""
        return ManyInverter(self.invert)

    @property
    def bvp(self) -> Inverter:
        """`invert` as a two-point boundary value problem; ArgumentError where the library has
        none.
        """
        return self._inverter("bvp", "one that was generated with parts=['bvp'] (--with bvp)")

    @property
    def invert_limited(self) -> LimitedInverter:
        """Inverse dynamics along whole paths within limits; ArgumentError where the library has
        none.
        """
        found = self._inverter("invert_limited", f"{_INVERTS}, in double precision")
        assert isinstance(found, LimitedInverter)
        return found

    def _inverter(self, name: str, expected: str) -> Inverter:
        """The function ``name``; ArgumentError where the library lacks it, with the library
        ``expected`` in words.
        """
        found = self._inverters.get(name)
        if found is None:
            raise ArgumentError(
                f"{self.name}: given a library without {name}, expected {expected}"
            )
        return found

    @property
    def growth(self) -> Growth:
        """Largest growth of a perturbation along a motion; ArgumentError where the library has
        none.
        """
        if self._growth is None:
            raise ArgumentError(
                f"{self.name}: given a library without growth, expected {_INVERTS}, with "
                "linearize (and with the part force inverse_dynamics_derivatives)"
            )
        return self._growth

    def path_sampler(self, table: Any, *, parameters: Any = None) -> PathSampler:
        """Samples of a planned path by the library: ``y, dy, ddy = sampler(t)``.

        Parameters
        ----------
        table : array (n,)
            Of `Path.table`.
        parameters : array (n_p,), optional
            Run-time parameters, where the library has any; default: those of the model file.

        Returns
        -------
        PathSampler

        Raises
        ------
        ArgumentError
            The library has no sampler or is closed, or the table is not one of this model.
        """
        if self.samplers is None:
            raise ArgumentError(
                f"{self.name}: given a library without path_sample, expected {_INVERTS}"
            )
        return PathSampler(self.samplers, table, parameters)

    @checked_types(own=("hold", "delay"))
    def stream(
        self,
        y: Any,
        q_start: Any,
        *,
        period: float,
        intervals: int,
        samples_per_interval: int = 1,
        tolerance: float | None = None,
        hold: str = "spline",
        delay: float = 0.0,
        parameters: Any = None,
        dy: Any = None,
        ddy: Any = None,
        servo: Any = None,
        force: Any = None,
    ) -> Stream:
        """Start inverse dynamics on a moving horizon, at rest at a given output or in motion.

        Parameters
        ----------
        y : array (n_t,)
            Output; for a pose the position [m], then the rotation matrix by columns. In motion:
            array (intervals + 16, n_t), one sample per update; the first update takes the next one
            and gives the interval from sample 16 on.
        q_start : array (n_a,)
            Initial guess of the arm's equilibrium there (in motion: at sample 7) [rad, m].
        period, intervals : float [s], int
            Time between two updates; intervals of the horizon, one per update.
        samples_per_interval : int
            Samples of the results per update.
        tolerance : float, optional
            Largest residual of the unactuated rows, relative to their torques at equilibrium;
            above it an interval is not ``converged``. Default: 1e-6, in single precision 1e-3.
        hold : str
            What the drive does between two samples: ``"spline"``, ``"linear"`` or ``"zoh"``;
            ``tau_m`` is what to send.
        delay : float
            From a sample until the motor has its torque, in samples, 0 to 4.
        parameters : array (n_p,), optional
            Run-time parameters; default: those of the model file. `Stream.set_parameters` changes
            them.
        dy, ddy : array (intervals + 16, n_y), optional
            First and second derivatives of the output, for a stream that starts in motion.
            Coordinates without motor are then in quasi-static motion; what differs from it in the
            real arm decays with the stable zeros.
        servo : True or mapping, optional
            The positions to send too, as `Library.invert` takes it; the stream starts at rest.
        force : array (n_y,), optional
            Force on the output until `Stream.set_force`; in motion (intervals + 16, 3 n_y), as
            there. Part ``"force"``.

        Returns
        -------
        Stream

        Raises
        ------
        ArgumentError
            Where an argument has another shape or is out of range, or the library has no streams.
        SolverError
            Where there is no equilibrium with this output.
        """
        if self._closed:
            raise closed_error(self.name)
        if self.streams is None:
            raise ArgumentError(
                f"{self.name}: given a library without streams, expected {_INVERTS}"
            )
        return Stream(
            self.sizes,
            self.streams,
            y,
            q_start,
            period=period,
            intervals=intervals,
            samples_per_interval=samples_per_interval,
            tolerance=tolerance,
            hold=hold,
            delay=delay,
            parameters=parameters,
            dy=dy,
            ddy=ddy,
            servo=servo,
            force=force,
        )

    @property
    def ports(self) -> dict[str, tuple[tuple[Port, ...], tuple[Port, ...]]]:
        """Inputs and outputs of every function."""
        return {name: (f.inputs, f.outputs) for name, f in self.functions.items()}

    @property
    def closed(self) -> bool:
        """True after `close`."""
        return self._closed

    def close(self) -> None:
        """Refuse every call from now on; closing twice does no harm. Calls under way end as
        usual.
        """
        self._closed = True
        for function in self.functions.values():
            function.close(self.name)
        for solver in (*self._inverters.values(), self._inverse_kinematics):
            if solver is not None:
                solver.close()
        for offered in (self.streams, self.samplers, self._growth):
            if offered is not None:
                offered.closed.set()

    def __enter__(self) -> Library:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __copy__(self) -> Library:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Library:
        return self

    def __reduce__(self) -> Any:
        if self._closed:
            raise closed_error(self.name)
        return library_again, self._again

    def __getattr__(self, name: str) -> Function:
        functions = self.__dict__.get("functions", {})
        if name in functions:
            return functions[name]
        raise AttributeError(
            f"given {name!r}, expected one of the library's functions: {', '.join(functions)}"
        )

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.functions})

    def __repr__(self) -> str:
        state = "closed, " if self._closed else ""
        plural = "" if len(self.functions) == 1 else "s"
        return (
            f"<Library {self.name}: {state}{len(self.functions)} function{plural}, "
            f"{self.precision} precision>"
        )


@checked_types
def load(directory: str | os.PathLike[str], device: str = "cpu") -> Library:
    """Load a generated library.

    Nothing of it runs before its file is known to be the one of the manifest, whole, and safe from
    other users; nothing is called before its ABI version, model digest, interface, sizes and types
    of numbers are those of the manifest and of this Python. `flexgen.runtime.files` says which
    owners and rights are refused.

    Parameters
    ----------
    directory : str or Path
        What `flexgen.generate` wrote.
    device : str
        ``"cpu"``; ``"cuda"`` (``"cuda:1"``: the second card): its functions run on an NVIDIA GPU,
        on device arrays.

    Returns
    -------
    Library

    Raises
    ------
    ArgumentError
        Where the directory is not a path, or the device is none of these.
    BuildError
        Where there is no library, not the one that the manifest describes, or one that other users
        may change.

    Examples
    --------
    >>> written = flexgen.generate("elbow", functions=["gravity"])
    >>> library = flexgen.load(written.directory)
    >>> library.gravity([0.0, 0.0]).round(1)  # N m
    array([-867.9, -867.9])
    """
    if not isinstance(directory, str | os.PathLike) or not isinstance(os.fspath(directory), str):
        raise ArgumentError(
            f"directory: given {directory!r}, expected the path of what flexgen.generate wrote"
        )
    if "\0" in os.fspath(directory):
        raise ArgumentError(f"directory: given {str(directory)!r}, expected the path of a folder")
    library = _load(Path(directory), None)
    return library if device == "cpu" else registry.extension("devices", "cuda")(library, device)


def library_again(directory: str, sha256: str) -> Library:
    """The library that was pickled; BuildError where another one is in its directory now."""
    return _load(Path(directory), sha256)


def function_again(directory: str, sha256: str, name: str) -> Function:
    """The function that was pickled; BuildError where another library is in its directory now."""
    return library_again(directory, sha256).functions[name]


def _load(folder: Path, sha256: str | None) -> Library:
    """Load the library of a folder, where its file has the given digest."""
    trusted, manifest = read_manifest(folder)
    try:
        name = manifest["name"]
        file = manifest["build"]["library"]
        recorded = manifest["build"]["sha256"]
        if c_name_problem(name) is not None:
            raise BuildError(
                f"name of the library: given {name!r}, expected {c_name_problem(name)}; {AGAIN}"
            )
        named = _LIBRARY_FILE.match(file)
        if named is None or named["name"] != name or named["hash"] != recorded[:16]:
            raise BuildError(
                f"{folder}: given the library's file name {file!r}, expected "
                f"lib{name}-{recorded[:16]}.so; {AGAIN}"
            )
        if sha256 not in (None, recorded):
            raise BuildError(
                f"{folder}: given a library of SHA-256 {recorded[:16]}..., expected that of "
                f"{str(sha256)[:16]}..., which was pickled; pickle again what is there now"
            )
        refuse_other_computer(manifest["build"])
        library = load_verified(trusted / file, recorded)
        verify(library, manifest)
        negative = [status for status in manifest["statuses"] if status["code"] < 0]
        failures = {
            status["code"]: (_exception(status["exception"]), status["text"])
            for status in negative
        }
        parameters = read_parameters(library, manifest)
        functions = {
            f["name"]: _function(
                library, manifest, f, failures, parameters, (str(trusted), recorded, f["name"])
            )
            for f in manifest["functions"]
        }
        found = partial(entry_of, library)
        others = ("streams", "samplers", "inverse_kinematics", "growth")
        again = {
            what: (offered_again, (str(trusted), recorded, what))
            for what in (*_INVERTERS, *others)
        }
        inverters = {
            kind: inverter_of(manifest, found, failures, again[kind], kind, parameters, form)
            for kind, form in _INVERTERS.items()
        }
        streams = streams_of(manifest, found, failures, again["streams"], parameters)
        samplers = samplers_of(manifest, found, failures, again["samplers"], parameters)
        poses = inverse_kinematics_of(manifest, found, failures, again["inverse_kinematics"])
        made = Library(
            folder, manifest, functions, parameters, inverters, streams, samplers, poses
        )
        made._growth = growth_of(manifest, found, failures, again["growth"], parameters)
        return made
    except BuildError as error:
        raise error if str(folder) in str(error) else BuildError(f"{folder}: {error}") from error
    except OSError as error:
        raise BuildError(
            f"{folder}: given a library that cannot be loaded ({error}); {AGAIN}"
        ) from error
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        if isinstance(error, FlexgenError):
            raise BuildError(f"{folder}: {error}; {AGAIN}") from error
        raise BuildError(
            f"{folder / 'manifest.json'}: given an incomplete manifest ({error!r}); {AGAIN}"
        ) from error


def _exception(name: str) -> type[FlexgenError]:
    found = getattr(errors, name, None)
    if not (isinstance(found, type) and issubclass(found, FlexgenError)):
        raise ValueError(f"given the exception {name!r}, expected a class of flexgen.base.errors")
    return found


def offered_again(directory: str, sha256: str, what: str) -> Any:
    """Attribute ``what`` of the library of a pickled object; BuildError where another library is
    in its directory now.
    """
    offered = getattr(library_again(directory, sha256), what)
    if offered is None:
        raise BuildError(f"{directory}: given a library without {what}, expected {_INVERTS}")
    return offered


def _function(
    library: ctypes.CDLL,
    manifest: dict[str, Any],
    described: dict[str, Any],
    failures: Failures,
    parameters: np.ndarray,
    again: tuple[str, str, str],
) -> Function:
    """One function of the library with its C entry points, as the manifest has ``described`` it;
    ValueError where that is not consistent. ``again``: folder, hash and name, for pickling.
    """
    name = described["name"]
    if c_name_problem(name) is not None:
        raise ValueError(f"given the function name {name!r}, expected {c_name_problem(name)}")
    inputs, outputs = (
        tuple(Port(p["name"], tuple(p["shape"]), p["unit"], p["doc"]) for p in described[key])
        for key in ("inputs", "outputs")
    )
    for port in inputs:
        if port.name == PARAMETERS and port.shape != parameters.shape:
            raise ValueError(
                f"given {port.shape} as the shape of {name}'s parameters, expected "
                f"{parameters.shape}"
            )
    prefix = manifest["name"]
    single, batch = (entry_of(library, f"{prefix}_{name}{suffix}") for suffix in ("", "_batch"))
    work, batch_work = (
        entry_of(library, f"{prefix}_{suffix}") for suffix in ("work", "batch_work")
    )
    return Function(
        name,
        described["summary"],
        described["equation"],
        inputs,
        outputs,
        Entries(single, batch, int(work()) if described["work"] else 0, batch_work),
        REALS[manifest.get("precision", "double")],
        failures,
        parameters,
        (function_again, again),
        shared="" if manifest.get("per_point") else PARAMETERS,
    )

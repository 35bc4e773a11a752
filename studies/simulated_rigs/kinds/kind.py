"""What a kind of rig is: its equations, what is measured, how it is driven, and which laws may be missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from simulated_rigs.assembly import Assembly, Balance, Coupling
from simulated_rigs.plant import Plant

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Drive:
    """How an input is driven: around ``centre``, by up to ``height``, in units of ``clock`` s."""

    centre: float
    height: float
    clock: float


@dataclass(frozen=True)
class RigKind:
    """One kind of rig.

    Parameters
    ----------
    name : str
        Also the folder of its model.
    parameters : mapping of str to float
        Values in the Modelica file, from which the fit starts.
    known : tuple of str
        Parameters whose value in the file is right; all others are free.
    inputs : mapping of str to Drive
    states : mapping of str to Balance
    outputs : tuple of str
    units : mapping of str to str
        Of inputs and outputs; empty where the model declares none.
    step, rows : float, int
        Sample interval in s and number of samples.
    pieces : int
        Integration steps a sample.
    plant : callable
        Parameters -> equations.
    rest : callable
        Parameters -> states at rest under the drives' centres.
    sizes, shake : tuple of float
        Per state how large it usually gets, and the standard deviation of where a recording starts, about rest.
    laws : mapping of str to str
        Per place the laws that may be missing there, in one string; inputs as ``in:NAME``, outputs as ``out:NAME``.
    couplings : mapping of str to Coupling
    linear : bool
        Whether the equations without laws are linear.
    """

    name: str
    parameters: Parameters
    inputs: Mapping[str, Drive]
    states: Mapping[str, Balance]
    outputs: tuple[str, ...]
    units: Mapping[str, str]
    step: float
    rows: int
    plant: Callable[[Parameters], Plant]
    rest: Callable[[Parameters], list[float]]
    sizes: tuple[float, ...]
    shake: tuple[float, ...]
    laws: Mapping[str, str]
    known: tuple[str, ...] = ()
    pieces: int = 1
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    linear: bool = True

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that the fit may change."""
        return tuple(name for name in self.parameters if name not in self.known)

    def assemble(self, parameters: Parameters) -> Assembly:
        """Assemble the rig without laws."""
        return Assembly(
            self.plant(parameters), tuple(self.inputs), tuple(self.states), self.outputs, self.states, parameters,
            self.couplings,
        )  # fmt: skip


def at_zero(count: int) -> Callable[[Parameters], list[float]]:
    """Return the rest states of a rig that rests with all ``count`` states at zero."""
    return lambda p: [0.0] * count


#: Laws of dry friction, which any sliding or turning part may have.
FRICTION = "coulomb_friction friction_by_direction stribeck_friction presliding_friction"
#: What an actuator of flow, heat or voltage may have; a drive that reverses may have a dead zone too.
ONE_WAY = "saturation rate_limit square_law lag delay hysteresis"
ACTUATOR = f"dead_zone {ONE_WAY}"

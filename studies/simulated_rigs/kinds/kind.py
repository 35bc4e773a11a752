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

    ``name`` is also the folder of its model, ``parameters`` are the values in the Modelica file, from which the fit
    starts; ``known`` are right there, all others are free. ``units`` are those of inputs and outputs (none where the
    model declares none), ``step`` is the sample interval in s, ``rows`` the number of samples. ``plant`` and ``rest``
    make of parameters the equations, and the states at rest under the drives' centres. ``sizes`` and ``shake`` have
    per state how large it usually gets, and the standard deviation of where a recording starts, about rest. ``laws``
    has per place the laws that may be missing there, in one string; inputs as ``in:NAME``, outputs as ``out:NAME``.
    ``linear`` says whether the equations without laws are, ``method`` is SciPy's for the others. A command holds for
    ``hold`` samples.
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
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
    linear: bool = True
    method: str = "DOP853"
    hold: int = 1

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that the fit may change."""
        return tuple(name for name in self.parameters if name not in self.known)

    def assemble(self, parameters: Parameters) -> Assembly:
        """Assemble the rig without laws."""
        return Assembly(
            self.plant(parameters), tuple(self.inputs), self.states, self.outputs, parameters, self.sizes,
            self.couplings, self.method,
        )  # fmt: skip


def at_zero(count: int) -> Callable[[Parameters], list[float]]:
    """Return the rest states of a rig that rests with all ``count`` states at zero."""
    return lambda p: [0.0] * count


#: Laws of dry friction, which any sliding or turning part may have.
FRICTION = "coulomb_friction friction_by_direction stribeck_friction presliding_friction"
#: What an actuator of flow, heat or voltage may have; a drive that reverses may have a dead zone too.
ONE_WAY = "saturation rate_limit square_law lag delay hysteresis"
ACTUATOR = f"dead_zone {ONE_WAY}"

"""What a filter asks of whoever watches its sensors.

`navfilter.faults.monitor.FaultMonitor` is the one of the navigator. A monitor reads the filter (`FilterState`), keeps
its own memory, and changes the filter by actions only (`navfilter.filter.actions`).
"""

from collections.abc import Generator, Iterator, Mapping
from typing import Any, Protocol

from navfilter.filter.actions import Action
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Adoption
from navfilter.filter.records import Tape
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.foundation.arrays import Array, ArrayLike, Ints
from navfilter.models.error_models import Errors
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.start import Start
from navfilter.models.state import NavState
from navfilter.models.vehicle import Vehicle

#: Actions that end with an answer.
Actions = Generator[Action, None, Any]


class FilterState(Protocol):
    """A filter, as monitor and learning read it; see `navfilter.filter.filter.Filter`."""

    vehicle: Vehicle
    start: Start
    tape: Tape | None
    memory: FilterMemory
    layout: Layout
    in_force: Vehicle
    channels: dict[str, Channel]
    monitor: Any
    inertial: bool
    period_s: float
    drive_output: Array
    bench: Array
    bank: Array
    plan: Ints

    prepared: list[Adoption]

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""

    @property
    def nav(self) -> Array:
        """Nominal state, see `NavState.pack`; shape (17,)."""

    @property
    def x(self) -> Array:
        """Estimated error states behind the nine of navigation, shape (n - 9,)."""

    @property
    def P(self) -> Array:
        """Covariance of all error states as of the last fold, shape (n, n)."""

    @property
    def counts(self) -> dict[str, int]:
        """Irregularities so far."""

    @property
    def state(self) -> NavState:
        """The state with its covariance, now."""

    def described_models(self, others: Mapping[str, Errors]) -> dict[str, Errors]:
        """Error models put in force since the start, or others, without the constants of sensors that have jumped."""


class Monitor(Protocol):
    """Judges measurements and samples of the inertial unit; what it remembers stands in `FilterMemory.monitor`.

    Attributes
    ----------
    counted : tuple of str
        What it counts, see `Count`.
    sample_limits : ndarray
        Limits of samples by axis, as kernels take them.
    in_batches : bool
        Whether a kernel may take readings in batches without asking for each.
    has_pending : bool
        The readings that were refused last have made something necessary, see `pending`.
    """

    counted: tuple[str, ...]
    sample_limits: Array
    in_batches: bool
    has_pending: bool

    def initial_memory(self, filter: FilterState, memory: FilterMemory) -> Any:
        """Its memory before the first input, which says itself whether it `has_excluded` an axis of the unit; that of
        the filter has none yet.
        """

    def room(self, layout: Layout, channels: Mapping[str, Channel]) -> tuple[int, int]:
        """Numbers that its bank of faults remembers, and how many more it works with."""

    def restore(self, memory: Any, channels: Mapping[str, Channel], room: Array) -> None:
        """Let every channel have what is remembered of its sensor, as `Channel.faults`, and the kernels its bank."""

    def transform(self, filter: FilterState, memory: Any, M: Array, room: Array) -> None:
        """The error states are M times what they were."""

    def begin_again(self, filter: FilterState, memory: Any) -> None:
        """Velocity and attitude have been set anew: what innovations have told of slow faults is of another state."""

    def problem(self, memory: Any, fresh: Any, channels: Mapping[str, Channel]) -> str | None:
        """What is wrong with a memory that came from outside, in words; None when nothing is. fresh: one of the same
        layout, at the start.
        """

    def transferred(self, filter: FilterState, memory: FilterMemory, layout: Layout, given: FilterMemory) -> Any:
        """Its memory where a filter begins anew from the state of another one, with these states.

        Parameters
        ----------
        filter : FilterState
            As it was.
        memory : FilterMemory
            With which it begins anew; what the monitor remembers is not there yet.
        layout : Layout
        given : FilterMemory
            Of the other one.
        """

    # ---------------------------------------------------------------- measurements
    def gate(self, channel: Channel, z: Array, sd: ArrayLike | None, time_s: float) -> tuple[Array, Array]:
        """Limits of the gate for a reading, see ``Channel.limits``; and its white variances, empty where they are those
        of the error model.
        """

    def is_stale(self, filter: FilterState, channel: Channel, time_s: float) -> bool:
        """Whether a reading that has the value of the one before says nothing new."""

    def after_gate(self, filter: FilterState, channel: Channel, time_s: float, frozen: bool) -> Actions:
        """After a reading has been gated: whether it is let in after all, and its NIS by the description."""

    def pending(self, filter: FilterState) -> Actions:
        """What refused readings have made necessary, before the next input; whether slow faults were looked for."""

    # ---------------------------------------------------------------- the inertial unit
    def sample_sd(self, drive: Mechanisation, white: Array) -> Array:
        """By how much samples are to differ from one to the next, shape (6,)."""

    def set_imu_noise(self, memory: Any, C: Array, r: Array, output: Array) -> bool:
        """Write the error models of the axes as they are believed now to `output` (6, k + 1); whether any force is
        felt.
        """

    def rate_variance(self, memory: Any, r: Array) -> Array:
        """Variance of the angular rate as it is used for lever arms, shape (3,)."""

    def check_samples(self, samples: Array, memory: Any, sd: Array) -> int:
        """How many samples may be taken before something has to be heeded; bad axes are replaced in them."""

    def last_values(self, memory: Any) -> Array | None:
        """Of the last sample of an inertial unit as it came, shape (6,), whatever stood in for it; else None."""

    def replace_missing(self, filter: FilterState, samples: Array, said_s: float) -> Iterator[Action]:
        """Write values for samples that are missing."""

    def has_findings(self, memory: Any) -> bool:
        """Whether something has been found in the samples."""

    def act_on_imu(self, filter: FilterState) -> Actions:
        """Act on what has been found in the samples."""

    def excluded_axes(self, memory: Any) -> list[str]:
        """Names of the axes that something else stands in for."""

    def propagation(self, memory: Any) -> str:
        """What carries the state: "inertial", or "dead-reckoning"."""

    def conditions(self, memory: Any) -> dict[str, str]:
        """Condition of every axis in words; none where nothing is watched."""

    def on_silence(self, filter: FilterState, missing: bool) -> Iterator[Action]:
        """Before samples or a reading: note when nothing is heard any more, and what follows when it ends."""

"""Constants of the fault rules."""

from __future__ import annotations

#: For so long after it was refused a sensor may be wrong again [s]: it has to follow turns meanwhile.
UNDISPUTED_S = 600.0
#: Over so long a time refused readings must agree [s]: echoes and passing iron are shorter. A velocity that is not
#: heard is lost sooner, for what accelerometers and tilt gather in seconds lets the gate in.
SPAN_S, VELOCITY_SPAN_S = 8.0, 2.0

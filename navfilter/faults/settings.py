"""Constants of the fault rules."""

from __future__ import annotations

#: For so long after it was refused a sensor may be wrong again [s]: it has to follow turns meanwhile.
UNDISPUTED_S = 600.0

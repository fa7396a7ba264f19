"""Arrays of numbers, as the signatures of the package call them."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike as ArrayLike
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Complex = NDArray[np.complex128]
#: Of any elements.
AnyArray = NDArray[Any]

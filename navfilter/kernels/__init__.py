"""Compiled functions on arrays: they import only math, numpy, numba, each other, and what compiles them (`compiling`).

Those that allocate nothing are compiled with ``_nrt=False`` (`UNCOUNTED`): numba does not count references to arrays in
them, which took a third of a replay, for a slice of an array is counted twice, each time by an atomic instruction. Such
a kernel must not return an array. What it calls is compiled in the same way unless it says ``_nrt=True`` (`COUNTED`).
"""

from navfilter.kernels.compiling import shipped  # noqa: F401 - what numba keeps is also looked for beside the package

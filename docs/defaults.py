"""The reference shows defaults in the signature only.

griffe, which reads the docstrings, gives both of ``a, b : float`` the default of ``a``.
"""

from typing import Any

import griffe


class Defaults(griffe.Extension):
    """Takes the defaults out of the lists of parameters, once the package is loaded."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Go through all classes and functions."""
        self._take_out(pkg)

    def _take_out(self, parent: Any) -> None:
        for thing in parent.members.values():
            if thing.is_alias:
                continue
            for section in thing.docstring.parsed if thing.docstring else ():
                if section.kind is griffe.DocstringSectionKind.parameters:
                    for parameter in section.value:
                        parameter.default = None
            if thing.is_module or thing.is_class:
                self._take_out(thing)

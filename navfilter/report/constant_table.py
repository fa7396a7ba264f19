"""The constants of a run as a table with lights: by colour, by shape and in words, so that it reads in grey, too."""

from collections.abc import Iterable, Sequence

from navfilter.calibration.lights import LEFT, Light
from navfilter.check.units_text import amount, with_sd
from navfilter.rendering.page import escape

#: A light as a sign and in words.
_SIGNS = {"green": ("&#9679;", "told"), "orange": ("&#9650;", "half told"), "red": ("&#9632;", "hardly told")}
ABOUT = (
    f"Green: what is left of the doubt is no more than the limit (stated by --limit, else {LEFT:.0%} of the sd that "
    "vehicle.toml describes); orange: up to twice that; red: beyond. Grey bar: described, with 1 sd; black: found."
)
#: The little figure: half its width [px], and how many described sds that is.
_HALF, _REACH = 50.0, 2.5


def lights_html(lights: Sequence[Light]) -> str:
    """The table of a run."""
    head = ("constant", "described", "found", "", "limit of the sd", "")
    rows = (
        (
            escape(one.name),
            with_sd(one.given, one.given_sd, one.unit),
            with_sd(one.value, one.sd, one.unit),
            _figure(one),
            amount(one.limit, one.unit),
            _light(one.colour, _SIGNS[one.colour][1]),
        )
        for one in lights
    )
    return _table(head, rows)


def lights_text(lights: Sequence[Light]) -> str:
    """How many constants are told, and which are not, in one line; empty where there are none."""
    counts = [f"{sum(one.colour == colour for one in lights)} {_SIGNS[colour][1]}" for colour in _SIGNS]
    red = [f"{one.name} (sd {amount(one.sd, one.unit)})" for one in lights if one.colour == "red"]
    return f"constants: {', '.join(counts)}{': ' * bool(red)}{', '.join(red)}" if lights else ""


def _light(colour: str, text: str) -> str:
    return f'<span class="light {colour}">{_SIGNS[colour][0]}</span> {text}'


def _figure(one: Light) -> str:
    """Described and found on one line, in sds as described."""

    def at(value: float) -> float:
        return _HALF * (1.0 + max(-1.0, min(1.0, (value - one.given) / (_REACH * one.given_sd))))

    low, high = at(one.value - one.sd), at(one.value + one.sd)
    return (
        f'<svg class="spread" viewBox="0 0 {2 * _HALF:g} 12" width="{2 * _HALF:g}" height="12" aria-hidden="true">'
        f'<rect x="{at(one.given - one.given_sd):.1f}" y="3" width="{2 * _HALF / _REACH:.1f}" height="6" fill="#ccc"/>'
        f'<path d="M{low:.1f} 6H{high:.1f}M{low:.1f} 2V10M{high:.1f} 2V10" stroke="#111" fill="none"/>'
        f'<circle cx="{at(one.value):.1f}" cy="6" r="2" fill="#111"/></svg>'
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Cells that are HTML already; all but numbers to the left."""
    top = "".join(f"<th>{cell}</th>" for cell in head)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f'<div class="wide"><table class="lights"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'

"""The look of a run, the same in HTML, SVG and the terminal: hue by engine; shade, dash and marker by method.

Colours are made in OKLCH, in which equal steps of lightness look equal (https://bottosson.github.io/posts/oklab).
Of the first `SHADES` times `DASHES` runs of an engine, no two have the same colour and dash. A method that `METHODS`
lists looks the same in every report, figure and study, whichever others are beside it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

from crosscheck.document import grouped

HUES = {"lieeuler": 250.0, "mujoco": 50.0, "pinocchio": 335.0, "exudyn": 155.0, "drake": 95.0, "dart": 20.0,
        "newton": 200.0, "mjx": 290.0, "heyoka": 0.0}
"""Hues in degrees. An engine that is not listed gets one from a hash of its name."""

METHODS = {
    "lieeuler": ("DAE3L_LE DAE2L_LE DAE2L_LSE DAE1L_LSE DAE3H_LE DAE2H_LE DAE2H_LSE DAE1H_LSE INDEX1_LE BAUMGARTE_LE "
                 "generalized_alpha rattle2 rattle4 rattle6 rattle8 rkmk4 rkmk54 rkmk853 seulex taylor"),
    "mujoco": "Euler implicit implicitfast RK4 discrete",
    "pinocchio": "SymplecticEuler RK4naive RKMK4 RKMK8",
    "exudyn": "GeneralizedAlpha TrapezoidalIndex2 RK44 RK67 DOPRI5"}
"""Methods of engines in the order of their looks; those of other engines follow the order in which they appear."""

FORMS = {"tree": 0, "maximal": 1, "pivot": 2}
"""Places of the forms of a method, one after the other; lieeuler has one form only."""

LIGHT, DARK = (0.40, 0.64, 0.52, 0.58, 0.46), (0.88, 0.62, 0.75, 0.68, 0.82)
"""Lightness of the shades on light and on dark pages. Successive shades differ much."""

CHROMA = 0.14

SHADES = len(LIGHT)

DASHES = ("solid", "10px 4px", "2px 3px", "10px 3px 2px 3px", "16px 4px", "6px 2px 2px 2px 2px 2px", "4px 4px")
"""Dashes in the notation of Plotly and SVG, in pixels."""

MARKERS = (("circle", "o", "●"), ("square", "s", "■"), ("diamond", "D", "◆"), ("triangle-up", "^", "▲"),
           ("triangle-down", "v", "▼"), ("pentagon", "p", "⬟"), ("hexagram", "*", "✶"), ("cross", "P", "✚"))
"""Markers: name in Plotly, name in Matplotlib, and sign for texts."""


@dataclasses.dataclass(frozen=True)
class Look:
    """How a run is drawn."""

    light: str  # colour on a light page, #rrggbb
    dark: str
    dash: str  # lengths of lines and gaps in pixels, or "solid"
    marker: str  # Plotly's name
    matplotlib_marker: str
    sign: str

    def pattern(self, width: float = 1.6) -> str | tuple[float, tuple[float, ...]]:
        """The dash in Matplotlib's notation, in points, for a line of this width (pt)."""
        if self.dash == "solid":
            return "solid"
        return 0.0, tuple(float(part.removesuffix("px")) * width / 2.0 for part in self.dash.split())


def looks(labels: Mapping[str, Sequence[str]]) -> dict[str, dict[str, Look]]:
    """Looks by engine and label: engine, method and, in brackets, the form."""
    by_engine: dict[str, dict[str, Look]] = {}
    for engine, own in labels.items():
        name = engine.partition("==")[0]
        methods = METHODS.get(name, "").split()
        forms = len(FORMS) if name != "lieeuler" else 1
        free, taken = itertools.count(forms * len(methods)), set()
        by_engine[engine] = {}
        for label in own:
            method, _, form = label.removeprefix(f"{engine} ").partition(" (")
            row = FORMS.get(form.rstrip(")") or "tree", forms) if forms > 1 else 0 if form in ("", "maximal)") else 1
            place = row * len(methods) + methods.index(method) if method in methods and row < forms else next(free)
            if place in taken:
                place = next(free)
            taken.add(place)
            by_engine[engine][label] = look(engine, place)
    return by_engine


def of_runs(runs: Iterable[tuple[str, str]]) -> dict[str, dict[str, Look]]:
    """`looks` of runs, given as (engine, label)."""
    return looks({engine: list(dict.fromkeys(label for _, label in own))
                  for engine, own in grouped(runs, lambda run: run[0]).items()})


def for_scripts(runs: Iterable[tuple[str, str]]) -> dict[str, dict[str, tuple[str, str, str, str, str]]]:
    """Light and dark colour, dash, marker and sign by engine and label, for the scripts of pages."""
    return {engine: {label: (each.light, each.dark, each.dash, each.marker, each.sign) for label, each in own.items()}
            for engine, own in of_runs(runs).items()}


def look(engine: str, place: int) -> Look:
    """The look of an engine's run number `place`. Beyond `SHADES` times `DASHES` runs the hue changes a little."""
    shade, turn = place % SHADES, place // (SHADES * len(DASHES))
    name, equals, _ = engine.partition("==")
    hue = HUES[name] + (8.0 if equals else 0.0) if name in HUES else int.from_bytes(
        hashlib.sha256(engine.encode("utf-8", "surrogatepass")).digest()[:2]) % 360
    hue += 12.0 * turn
    marker = MARKERS[place % len(MARKERS)]
    return Look(_hex(LIGHT[shade], CHROMA, hue), _hex(DARK[shade], 0.8 * CHROMA, hue),
                DASHES[(place // SHADES + shade) % len(DASHES)], *marker)


def _hex(lightness: float, chroma: float, hue: float) -> str:
    """#rrggbb of a colour in OKLCH. The chroma is lowered until the colour is in sRGB."""
    while True:
        channels = _linear(lightness, chroma, hue)
        if all(-1e-4 <= each <= 1.0001 for each in channels) or chroma < 0.01:
            linear = [min(1.0, max(0.0, each)) for each in channels]
            return "#" + "".join(f"{round(255 * each):02x}" for each in (
                12.92 * each if each <= 0.0031308 else 1.055 * each ** (1 / 2.4) - 0.055 for each in linear))
        chroma -= 0.01


def _linear(lightness: float, chroma: float, hue: float) -> tuple[float, float, float]:
    a, b = chroma * math.cos(math.radians(hue)), chroma * math.sin(math.radians(hue))
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    middle = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    return (4.0767416621 * long - 3.3077115913 * middle + 0.2309699292 * short,
            -1.2684380046 * long + 2.6097574011 * middle - 0.3413193965 * short,
            -0.0041960863 * long - 0.7034186147 * middle + 1.7076147010 * short)

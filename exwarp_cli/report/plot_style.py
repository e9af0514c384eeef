"""How plots look: colours that the page's style sheet sets, and SVG that stands inside HTML."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

SERIES = 7
"""Colours of series: `--c0` to `--c6` of the style sheet, after Okabe and Ito."""

ROLES = (
    *("fg", "muted", "grid", "warp", "extrapolate", "hold", "blend", "interpolate", "key", "mark"),
    *("bg", "softsplat", "lookahead", "rendered"),
)
"""Further colours of the style sheet that plots use."""

COLOURS = {role: f"#fe01{i:02x}" for i, role in enumerate(ROLES)} | {
    f"c{i}": f"#fe02{i:02x}" for i in range(SERIES)
}
"""A colour for each name that matplotlib draws with, and that is replaced by the style sheet's."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Of series in their order: colour is never all that tells them apart."""

WIDTH = 7.2
"""Of a plot, inches of 72 units."""

IDS = "%PLOT%"
"""Stands before every id of a plot until the page gives it a number of its own."""

SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "exwarp",
    "text.parse_math": False,  # a dollar sign in a name is one
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": COLOURS["muted"],
    "axes.labelcolor": COLOURS["muted"],
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": COLOURS["grid"],
    "grid.linewidth": 0.6,
    "text.color": COLOURS["fg"],
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.4,
    "patch.edgecolor": COLOURS["fg"],
}

_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_FONT = re.compile(r"font-size: ([0-9.]+)px; font-family: [^;\"]*")


@dataclass(frozen=True)
class Labels:
    """What is written on a plot.

    Attributes
    ----------
    title
        Heading above it.
    x, y
        Axes, with units; empty for none.
    description
        What it shows in a sentence, for those who do not see it.
    """

    title: str
    x: str = ""
    y: str = ""
    description: str = ""


@dataclass(frozen=True)
class Figure:
    """A plot for a page.

    Attributes
    ----------
    labels
        Title and description.
    svg
        With `IDS` before every id.
    note
        A line below it; empty for none.
    """

    labels: Labels
    svg: str
    note: str = ""

    def numbered(self, name: str) -> Markup:
        """Return the SVG with ids that begin with a name, which has to be unique in the page."""
        return Markup(self.svg.replace(IDS, f"{name}-"))


def kind_role(kind: str) -> str:
    """Return the role whose colour stands for what makes a frame, a word out of `plots.KINDS`."""
    return kind if kind in ROLES else "muted"


def draw(labels: Labels, height: float, paint: Callable[[Axes], None], note: str = "") -> Figure:
    """Draw one panel, `height` inches high."""

    def single(canvas: Canvas) -> None:
        axes = canvas.add_subplot()
        axes.set_xlabel(labels.x)
        axes.set_ylabel(labels.y)
        paint(axes)

    return draw_panels(labels, height, single, note)


def draw_panels(
    labels: Labels, height: float, paint: Callable[[Canvas], None], note: str = ""
) -> Figure:
    """Draw several panels into one SVG, `height` inches high; the same input gives the same text.

    Settings of the user's own matplotlib are left out. Letters that its fonts lack are no matter,
    as the browser writes the text.
    """
    with _settings():
        from matplotlib.figure import Figure as Canvas

        canvas = Canvas(figsize=(WIDTH, height), layout="constrained")
        paint(canvas)
        text = io.StringIO()
        canvas.savefig(text, format="svg", metadata=_METADATA, transparent=True)
    return Figure(labels, inline(text.getvalue(), labels), note)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep matplotlib from telling of its caches and fonts, which it begins with on import."""
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


@contextmanager
def _settings() -> Iterator[None]:
    with quiet():
        import matplotlib

        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(SETTINGS)
            yield


def inline(text: str, labels: Labels) -> str:
    """Turn matplotlib's SVG into an element for HTML: no prologue, fonts or global style."""
    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    box = re.search(r'viewBox="([^"]*)"', body)
    body = body[body.index(">") + 1 :]
    body = re.sub(r'(<g) id="[^"]*"', r"\1", body)
    body = body.replace("xlink:href", "href")
    body = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{IDS}", body)
    body = _FONT.sub(r"font-size: \1px", body)
    for name, colour in COLOURS.items():
        body = body.replace(colour, f"var(--{name})")
    body = re.sub(r"\s*\n\s*", " ", body)
    return opening(box[1] if box else "0 0 1 1", labels) + body.rstrip()


def opening(view_box: str, labels: Labels) -> str:
    """Return the opening tag of a plot, with its title and description."""
    title, description = escape(labels.title), escape(labels.description or labels.title)
    return (
        f'<svg class="plot" viewBox="{view_box}" role="img" '
        f'aria-labelledby="{IDS}title {IDS}desc">'
        f'<title id="{IDS}title">{title}</title><desc id="{IDS}desc">{description}</desc>'
    )

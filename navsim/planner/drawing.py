"""The two figures of the planner: the aerodrome with its map, and the sky. Updates change only their data sources.

Coordinates are in metres from the runway's threshold, along the direction of landing and right of it, which is
downwards, as on a map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import ColorBar, ColumnDataSource, CustomJS, LinearColorMapper, Range1d
from bokeh.plotting import figure

from navsim.gnss.sky import Horizon
from navsim.page import plots
from navsim.page.sky import beside, name_marks, sky_paper, skyline
from navsim.planner.outlook import Share
from navsim.planner.proposal import PlannedScenario
from navsim.report.sky import Sector
from navsim.trajectory.approach import TOUCHDOWN

Outline = tuple[str, list[np.ndarray], str]
"""Overlay: `area`, `line` or `point`; its parts (n, 2), along and right, m; its name."""
MAGENTA = "#E5007E"
"""Colour of jammers, which no map uses."""
_ROOM = 1.15
"""Factor of the area's width on that of its content."""
_LEAST = 1500.0
"""Least half width of an area, m."""


@dataclass(frozen=True)
class ShownArea:
    """Square on the screen, for which maps are computed: its middle, along and right, and half its width, m."""

    along: float
    right: float
    half: float

    def grid(self, count: int) -> np.ndarray:
        """The middles of count x count cells (count, count, 2), right first, along second; along and right, m."""
        step = 2.0 * self.half / count
        at = -self.half + step * (np.arange(count) + 0.5)
        along, right = np.meshgrid(self.along + at, self.right + at)
        return np.stack([along, right], axis=-1)


def area_of(proposal: PlannedScenario) -> ShownArea:
    """The area that holds runway, glide and all transmitters of a proposal, in round numbers."""
    path = _path(proposal)
    runway = np.array([[0.0, 0.0], [proposal.scenario.runway.length_m, 0.0]])
    sites = (proposal.places(), proposal.jammers(), proposal.beacons())
    seen = np.concatenate([path[:, :2], runway, *(each[:, :2] for each in sites)])
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = max(_LEAST, _ROOM * 0.5 * float((high - low).max()))
    along, right = (float(round(x, -2)) for x in 0.5 * (low + high))
    return ShownArea(along, right, float(np.ceil(half / 250.0) * 250.0))


def _path(proposal: PlannedScenario) -> np.ndarray:
    """Trajectory up to touchdown, or to the end, (n, 3), along, right and up."""
    end = min(proposal.trajectory.path.events.get(TOUCHDOWN, np.inf), proposal.scenario.duration_s)
    motion = proposal.trajectory.motion(np.linspace(0.0, end, 200))
    out = proposal.axes(motion.position_ecef)
    return np.column_stack([out[:, :2], motion.llh[:, 2] - proposal.scenario.runway.ellipsoidal_m])


class AerodromePlan:
    """The aerodrome. image: the map's cells. places: the transmitters. range: of both axes."""

    def __init__(self, proposal: PlannedScenario, area: ShownArea, overlay: list[Outline], on_pan: str) -> None:
        """on_pan: JavaScript with `cb_obj` for each drag event."""
        on = plots.plot("", "beyond the threshold (= -l1), m", "right of the axis, m", 600)
        on.update(sizing_mode=None, frame_width=560, frame_height=560, height=None, name="aerodrome")
        self.figure = on
        self.mapper: LinearColorMapper = plots.colour_map(0.0, 1.0, reverse=True)
        self.image = ColumnDataSource(
            {"image": [plots.as_float32(np.full((2, 2), np.nan))], "x": [0.0], "y": [0.0], "w": [1.0]}
        )
        drawn = on.image("image", "x", "y", "w", "w", source=self.image, color_mapper=self.mapper, level="image")
        on.grid.visible = False
        plots.bar(on, self.mapper, " ")
        self._bar = on.select_one(ColorBar)
        plots.metres_on_axes(on)
        self._fixed(on, proposal, overlay)
        self.places = ColumnDataSource({name: [] for name in ("x", "y", "said", "kind", "colour", "marker", "size")})
        on.scatter("x", "y", source=self.places, marker="marker", size="size", fill_color="colour",
                   line_color="white", line_width=1.5)  # fmt: skip
        on.text("x", "y", "said", source=self.places, text_color="black", x_offset=11, y_offset=-6,
                text_font_size="12px", text_font_style="bold", background_fill_color="white",
                background_fill_alpha=0.8, padding=2)  # fmt: skip
        plots.hover_text(on, [drawn], ("along", "$x{0} m"), ("right", "$y{0} m"), ("there", "@image{0.000}"))
        for event in ("panstart", "pan", "panend"):
            on.js_on_event(event, CustomJS(code=on_pan))
        for model in (on, self.image, self.places, self.mapper, *on.select(type=ColorBar)):
            model.syncable = False
        self.show(area)

    def _fixed(self, on: figure, proposal: PlannedScenario, overlay: list[Outline]) -> None:
        runway = proposal.scenario.runway
        for what, parts, text in overlay:
            xs, ys = [part[:, 0] for part in parts], [part[:, 1] for part in parts]
            if what == "area":
                on.multi_polygons(
                    [[xs]], [[ys]], fill_color=plots.GREY, fill_alpha=0.3, line_color="white", line_width=2.5
                )
                on.multi_polygons([[xs]], [[ys]], fill_alpha=0.0, line_color="#333333", line_width=1.0)
            elif what == "line":
                on.multi_line(xs, ys, line_color="white", line_width=3, line_alpha=0.7)
                on.multi_line(xs, ys, line_color="#333333", line_width=1.2)
            else:
                on.scatter(np.concatenate(xs), np.concatenate(ys), marker="square", size=6, fill_color="#333333",
                           line_color="white")  # fmt: skip
            if text:
                plots.names(on, xs[0].mean(), ys[0].mean(), [text], "black", background_fill_color="white",
                            background_fill_alpha=0.6)  # fmt: skip
        half = 0.5 * runway.width_m
        on.quad(left=0.0, right=runway.length_m, bottom=-half, top=half, fill_color="#222222", line_color="white",
                line_width=1.5)  # fmt: skip
        path = _path(proposal)
        of = plots.source(x=path[:, 0], y=path[:, 1], up=path[:, 2])
        plots.line(on, of, "y", "white", line_width=4.0, line_alpha=0.7)
        glide = plots.line(on, of, "y", "#222222", line_dash="dashed")
        plots.hover_text(on, [glide], ("", "glide"), ("height", "@up{0} m"), ("along", "@x{0} m"))
        interference = proposal.scenario.interference
        for ridge in (*proposal.scenario.terrain, *(() if interference is None else interference.horizon)):
            if getattr(ridge, "file", None) is not None:
                continue
            tops = proposal.axes(ridge.tops(proposal.threshold))
            on.multi_line([*tops[..., 0]], [*tops[..., 1]], line_color=plots.BROWN, line_width=3)

    def show(self, area: ShownArea) -> None:
        """Let the axes reach over an area."""
        low, high = area.along - area.half, area.along + area.half
        left, right = area.right - area.half, area.right + area.half
        if isinstance(self.figure.x_range, Range1d):
            self.figure.x_range.update(start=low, end=high, reset_start=low, reset_end=high)
            self.figure.y_range.update(start=right, end=left, reset_start=right, reset_end=left)
        else:
            plots.view_from_above(self.figure, (low, high), (left, right))

    def put(self, proposal: PlannedScenario) -> None:
        """Show the transmitters at their positions."""
        places, jammers, beacons = proposal.places(), proposal.jammers(), proposal.beacons()
        every = np.concatenate([places, jammers, beacons])
        interference = proposal.scenario.interference
        named = () if interference is None else tuple(each.name for each in interference.jammers)
        looks = ("pseudolite", plots.ORANGE, "circle", 15.0), ("jammer", MAGENTA, "diamond", 17.0), (
            "beacon", plots.GREEN, "square", 14.0)  # fmt: skip
        each = [look for look, sites in zip(looks, (places, jammers, beacons), strict=True) for _ in sites]
        said = [*proposal.names, *named, *proposal.beacon_names]
        self.places.data = {
            "x": every[:, 0].tolist(), "y": every[:, 1].tolist(), "said": said,
        } | {name: [row[i] for row in each] for i, name in enumerate(("kind", "colour", "marker", "size"))}  # fmt: skip

    def paint(self, values: np.ndarray, area: ShownArea, reach: tuple[float, float], text: str) -> None:
        """Show a map (n, n) over an area, with colours between two numbers; text: name of the quantity with its
        unit."""
        self.image.data = {
            "image": [plots.as_float32(values)], "x": [area.along - area.half], "y": [area.right - area.half],
            "w": [2.0 * area.half],
        }  # fmt: skip
        if (self.mapper.low, self.mapper.high) != reach:
            self.mapper.update(low=reach[0], high=reach[1])
        if self._bar.title != text:
            self._bar.title = text


def reach_of(values: np.ndarray) -> tuple[float, float]:
    """Between which numbers colours are spread: the smallest and the 90 % quantile, so that a few places without much
    of a solution do not take them all."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = float(known.min()), float(np.quantile(known, 0.9))
    return low, max(high, low * (1.0 + 1e-6) + 1e-9)


class SkyPlan:
    """The sky at the middle of the glide, with its mask."""

    def __init__(self, proposal: PlannedScenario, horizon: Horizon | None) -> None:
        sky = proposal.scenario.sky
        masked: list[Sector] = [(0.0, 360.0, 0.0, sky.mask_deg), (0.0, 360.0, sky.mask_upper_deg, 90.0)]
        masked += [(*part.azimuth_deg, *part.elevation_deg) for part in sky.interference]
        on = sky_paper("", 90.0, masked)
        on.update(name="sky", max_width=320)
        if horizon is not None:
            skyline(on, horizon.azimuth, horizon.elevation, sky.mask_deg)
        on.toolbar_location = None
        self.figure = on
        self.sources = ColumnDataSource(_directions([]))
        marks: Any = on.scatter("x", "y", source=self.sources, marker="marker", size=10, line_color="colour",
                                fill_color="colour", fill_alpha="full", line_width=1.5)  # fmt: skip
        name_marks(on, self.sources)
        plots.hover_text(
            on, [marks], ("", "@said, @how"), ("azimuth", "@azimuth{0.0}°"), ("elevation", "@elevation{0.0}°")
        )
        self.sources.syncable = False

    def put(self, shares: list[Share]) -> None:
        """Show sources."""
        self.sources.data = _directions([each for each in shares if each.elevation > -10.0])


def _directions(shares: list[Share]) -> dict[str, list[Any]]:
    azimuth = np.radians([each.azimuth for each in shares])
    away = np.minimum(90.0 - np.array([each.elevation for each in shares]), 90.0)
    x, y = (away * np.sin(azimuth)).tolist(), (away * np.cos(azimuth)).tolist()
    return beside(x, y, [each.name for each in shares], 90.0) | {
        "how": ["used" if each.used else "not used" for each in shares],
        "azimuth": [each.azimuth for each in shares],
        "elevation": [each.elevation for each in shares],
        "marker": ["triangle" if each.ground else "circle" for each in shares],
        "colour": [(plots.ORANGE if each.ground else plots.BLUE) if each.used else plots.GREY for each in shares],
        "full": [1.0 if each.used else 0.0 for each in shares],
    }

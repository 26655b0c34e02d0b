"""What a report may hold: plain data, every part optional, nothing measured or drawn here.

A part that is None or empty leaves no trace on the page. Arrays are in the project's conventions: metres, world frame,
radiance linear unless a field says otherwise. No field is filled in from the clock or the machine, so that equal
content gives equal bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stage.camera import Camera
from stage.lights import Light

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]
ByteImage = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]


def _expect(where: str, array: NDArray[Any], *shape: int | None) -> None:
    """Raise `ValueError` unless `array` has `shape`; None stands for any length."""
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=False)):
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        raise ValueError(f"{where}: expected shape ({wanted}), got {array.shape}")


@dataclass(frozen=True, eq=False)
class StageView:
    """The stage in 3-D: where the light could go, and where the plan sends it.

    Attributes
    ----------
    lights : (n, 3) float
        All candidates: positions in metres, or unit directions where `distant`.
    chosen : tuple of int
        Indices into `lights`, in the order of choice (shown as 1, 2, 3, ...).
    distant : bool
        Whether `lights` are directions.
    camera : Camera or None
        Drawn as its pinhole and field of view.
    surface : (m, 3) float or None
        Points on the object's surface, metres; of many, an even sample is drawn.
    surface_rgb : (m, 3) uint8 or None
        Display colour of each surface point.
    """

    lights: FloatArray
    chosen: tuple[int, ...] = ()
    distant: bool = False
    camera: Camera | None = None
    surface: FloatArray | None = None
    surface_rgb: ByteImage | None = None

    def __post_init__(self) -> None:
        _expect("StageView.lights", self.lights, None, 3)
        if any(not 0 <= index < len(self.lights) for index in self.chosen):
            raise ValueError(f"StageView.chosen: indices must lie in 0 to {len(self.lights) - 1}, got {self.chosen}")
        if self.surface is not None:
            _expect("StageView.surface", self.surface, None, 3)
            if self.surface_rgb is not None:
                _expect("StageView.surface_rgb", self.surface_rgb, len(self.surface), 3)

    def surface_sample(self, most: int = 5000) -> tuple[FloatArray, ByteImage | None]:
        """At most `most` evenly spaced surface points, in their order, and their colours."""
        if self.surface is None:
            return np.empty((0, 3)), None
        step = max(1, -(-len(self.surface) // most))
        return self.surface[::step], None if self.surface_rgb is None else self.surface_rgb[::step]


@dataclass(frozen=True, eq=False)
class Coverage:
    """Measurability of both reflection components against the number of lights (paper 003 Fig. 8, M17).

    Attributes
    ----------
    curve : tuple of (int, float, float)
        Number of lights, then the shares (0 to 1) of the surface whose diffuse and whose specular component is
        measurable.
    limit_diffuse, limit_specular : float
        Shares that all candidates together reach.
    target : float
        Share of the limit that the plan asked for, per component (1 asks for the limit itself).
    method : str
        Name of the planning method.
    lower_bound : int or None
        No plan that meets the target has fewer lights than this.
    """

    curve: tuple[tuple[int, float, float], ...]
    limit_diffuse: float
    limit_specular: float
    target: float = 1.0
    method: str = ""
    lower_bound: int | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """One held-out photograph beside its rendering (paper 001 Fig. 6, K18).

    Attributes
    ----------
    light : str
        What the light is called, for example ``"light 7, azimuth 30 deg, elevation 45 deg"``.
    model : str
        Name of the model that rendered.
    real, rendered : (height, width, 3) uint8
        RGB on the scale on which the errors were computed.
    mae, psnr, ssim : float or None
        Mean absolute error in grey levels of 255, peak signal to noise in dB, structural similarity; as measured by the
        evaluator, shown as they are.
    linear : bool
        True where 0 to 255 is linear in radiance: the preview is then shown through the sRGB curve, the error is not.
    """

    light: str
    model: str
    real: ByteImage
    rendered: ByteImage
    mae: float | None = None
    psnr: float | None = None
    ssim: float | None = None
    linear: bool = False

    def __post_init__(self) -> None:
        _expect("Comparison.real", self.real, None, None, 3)
        _expect("Comparison.rendered", self.rendered, *self.real.shape)


@dataclass(frozen=True, eq=False)
class TripletView:
    """Which three measured lights rendered which pixel (paper 001 Fig. 4, K20).

    Attributes
    ----------
    triples : (height, width, 3) int
        Indices into `lights` of the images blended at each pixel, any order; -1 where nothing was rendered.
    lights : (n, 3) float
        Positions in metres, or unit directions where `distant`.
    facets : (m, 3) int
        The whole triangulation of the lights.
    wanted : Light
        The light that was rendered.
    distant : bool
        Whether `lights` are directions.
    rendered : (height, width, 3) uint8 or None
        The rendering itself, RGB ready for display.
    model : str
        Name of the model.
    """

    triples: IntArray
    lights: FloatArray
    facets: IntArray
    wanted: Light
    distant: bool = False
    rendered: ByteImage | None = None
    model: str = "apparent-brdf"

    def __post_init__(self) -> None:
        _expect("TripletView.triples", self.triples, None, None, 3)
        _expect("TripletView.lights", self.lights, None, 3)
        _expect("TripletView.facets", self.facets, None, 3)


@dataclass(frozen=True, eq=False)
class ReflectanceFunction:
    """What one pixel saw as the light moved (paper 001 Fig. 1, K19).

    Attributes
    ----------
    directions : (n, 3) float
        From the surface point towards each light, world frame, any length but 0.
    values : (n, 3) float
        Linear radiance of the pixel under each light, RGB; NaN where it was not measured.
    pixel : (int, int)
        Row and column.
    picture : (height, width, 3) uint8 or None
        An image of the object, RGB ready for display, in which the pixel is marked.
    """

    directions: FloatArray
    values: FloatArray
    pixel: tuple[int, int]
    picture: ByteImage | None = None

    def __post_init__(self) -> None:
        _expect("ReflectanceFunction.directions", self.directions, None, 3)
        _expect("ReflectanceFunction.values", self.values, len(self.directions), 3)


@dataclass(frozen=True, eq=False)
class MapView:
    """Reflectance maps of one model and what of them was measured directly (paper 003 Fig. 10, M22).

    Attributes
    ----------
    maps : mapping of str to (height, width) or (height, width, 3) float
        ``diffuse``, ``specular``, ``roughness``, ``normals``, ``rung``, ``residual``, ``std_*``, ... Values that are
        not finite are shown as missing.
    model : str
        Name of the model.
    mask : (height, width) bool or None
        The object; without it, every pixel where any map is not 0.
    estimated : (height, width) bool or None
        True where measured directly, False where filled in.
    """

    maps: Mapping[str, FloatArray]
    model: str = ""
    mask: BoolArray | None = None
    estimated: BoolArray | None = None

    def __post_init__(self) -> None:
        sizes = {name: values.shape[:2] for name, values in self.maps.items()}
        sizes |= {name: a.shape for name, a in (("mask", self.mask), ("estimated", self.estimated)) if a is not None}
        if len(set(sizes.values())) > 1:
            raise ValueError(f"MapView: maps, mask and estimated must have one size, got {sizes}")


@dataclass(frozen=True, eq=False)
class Relit:
    """The object under light that was never there.

    Attributes
    ----------
    title : str
        What the light is.
    image : (height, width, 3) float
        Linear radiance, RGB; all pictures of a report are shown with one common exposure.
    outside : (height, width) bool or None
        Pixels whose light lies outside what was sampled.
    """

    title: str
    image: FloatArray
    outside: BoolArray | None = None

    def __post_init__(self) -> None:
        _expect("Relit.image", self.image, None, None, 3)


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Everything one report shows; see the parts for their fields.

    Attributes
    ----------
    title : str
        Headline of the page.
    lede : str
        One sentence below the headline: what was done to what.
    summary : tuple of (str, str)
        Label and value of the figures to be read first, ready to print.
    stage, coverage, triplets, reflectance, maps
        One view each, or None.
    comparisons : tuple of Comparison
        Real against rendered; those of one light stand together.
    relit : tuple of Relit
        Pictures under new light.
    models : tuple of mapping
        Rows of ``evaluate``: ``model``, ``train``, ``test``, ``mae``, ``psnr``, ``ssim``, ``fit_s``,
        ``render_ms_per_megapixel``, ``peak_mib`` and any further number or text; a value may be None. Nested values are
        not shown.
    models_scale : str
        One sentence that says what 255 grey levels are in this data.
    timings : mapping of str to float
        Seconds by step, in order.
    counts : mapping of str to float
        A model's ``statistics()``: how many observations were ``saturated``, ``dark``, ``shadowed``, ``outside``, ...,
        with or without the prefix ``observations_``; with ``observations`` as the total, shares are shown too.
    limits : tuple of str
        Sentences on what the models cannot show (M23).
    provenance : mapping of str to str
        Command, versions, date, sources; the date is the caller's.
    """

    title: str
    lede: str = ""
    summary: tuple[tuple[str, str], ...] = ()
    stage: StageView | None = None
    coverage: Coverage | None = None
    comparisons: tuple[Comparison, ...] = ()
    relit: tuple[Relit, ...] = ()
    triplets: TripletView | None = None
    reflectance: ReflectanceFunction | None = None
    maps: MapView | None = None
    models: tuple[Mapping[str, Any], ...] = ()
    models_scale: str = ""
    timings: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, float] = field(default_factory=dict)
    limits: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

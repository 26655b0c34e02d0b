"""One picture that sums a report up, for the first screen of a README: drawn by OpenCV, no browser needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from acquisition.dataset import staged_file
from api.report import imaging
from api.report.canvas import INK, MUTED, blank, colour_bar, draw_stage, fitted, paste, text_width, write
from api.report.content import BoolArray, ByteImage, ReportContent
from api.report.maps import MapPicture, map_pictures, object_mask
from api.report.markup import number

WIDTH = 1280
MARGIN, GAP, COLUMNS = 36, 24, 4
COLUMN = (WIDTH - 2 * MARGIN - (COLUMNS - 1) * GAP) // COLUMNS
MAX_TILE_HEIGHT = 340
HEAD, FOOT, LEGEND_LINE = 30, 52, 20
# Of many maps, those that name the object's material and how far it was measured.
_MAPS_SHOWN = ("diffuse albedo", "specular albedo, Ward's ρs", "roughness, Ward's α", "what was measured directly")


@dataclass(frozen=True, eq=False)
class Tile:
    """One picture of a row: heading above; a colour scale, a legend or a note below."""

    heading: str
    picture: ByteImage
    note: str = ""
    bar: tuple[str, str, int] | None = None
    legend: tuple[tuple[tuple[int, int, int], str], ...] = ()


def write_summary_picture(path: str | Path, content: ReportContent) -> None:
    """Write a PNG, 1280 pixels wide: the stage, the first comparison, the main maps and up to four relit pictures.

    Parameters
    ----------
    path : str or Path
        The file; an existing one is replaced in one step.
    content : ReportContent
        Parts that are None or empty are left out; so is what has no place in one picture.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    write_png(Path(path), summary_picture(content))


def write_png(path: Path, picture: ByteImage) -> None:
    """Write an RGB picture, wholly or not at all."""
    _, data = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    with staged_file(path) as temporary:
        temporary.write_bytes(data.tobytes())


def summary_picture(content: ReportContent) -> ByteImage:
    """Compose the picture: (height, 1280, 3) RGB uint8."""
    rows = [row for row in (_first_row(content), _map_tiles(content), _relit_tiles(content)) if row]
    blocks = [draw_header(content.title, content.lede, content.summary)] + [draw_row(row) for row in rows]
    return np.concatenate([*blocks, blank(WIDTH, MARGIN - 8)])


def draw_header(title: str, lede: str, summary: Sequence[tuple[str, str]]) -> ByteImage:
    """Title, lede and up to six figures with their labels."""
    height = 84 + (26 if lede else 0) + (66 if summary else 0)
    canvas = blank(WIDTH, height)
    room = WIDTH - 2 * MARGIN
    y = 60
    write(canvas, fitted(title, 30, room, 700), MARGIN, y, 30, INK, 700)
    if lede:
        y += 30
        write(canvas, fitted(lede, 16, room), MARGIN, y, 16, MUTED)
    shown = summary[:6]
    step = room // max(1, len(shown))
    for k, (label, value) in enumerate(shown):
        x = MARGIN + k * step
        write(canvas, fitted(label, 13, step - 12), x, y + 34, 13, MUTED)
        size = next((s for s in (21, 19, 17) if text_width(value, s, 600) <= step - 12), 15)
        write(canvas, fitted(value, size, step - 12, 600), x, y + 60, size, INK, 600)
    return canvas


def _first_row(content: ReportContent) -> list[Tile]:
    tiles = []
    if content.stage is not None:
        view = content.stage
        chosen = f", {len(view.chosen)} chosen" if view.chosen else ""
        beside = content.comparisons[0].real if content.comparisons else blank(COLUMN, COLUMN)
        drawn = draw_stage(view, COLUMN, _to_column(beside).shape[0])
        tiles.append(Tile("stage and lights", drawn, f"{len(view.lights)} lights{chosen}"))
    if content.comparisons:
        comparison = content.comparisons[0]
        top = imaging.difference_scale(content.comparisons)
        size = imaging.difference(comparison)
        real, rendered = (
            imaging.display(image / 255.0) if comparison.linear else image
            for image in (comparison.real, comparison.rendered)
        )
        figures = [f"MAE {number(comparison.mae, 3)} grey levels"] if comparison.mae is not None else []
        figures += [f"PSNR {number(comparison.psnr, 4)} dB"] if comparison.psnr is not None else []
        tiles += [
            Tile("photograph, held out", real, comparison.light),
            Tile(f"rendered: {comparison.model}", rendered, ", ".join(figures)),
            Tile(
                "size of the difference",
                imaging.colour_scale(size, 0, top, imaging.ERRORS),
                bar=("0", f"{top} grey levels", imaging.ERRORS),
            ),
        ]
    return tiles


def _map_tiles(content: ReportContent) -> list[Tile]:
    if content.maps is None or not content.maps.maps:
        return []
    mask = object_mask(content.maps)
    pictures = map_pictures(content.maps)
    main = [picture for label in _MAPS_SHOWN for picture in pictures if picture.label == label]
    return [_map_tile(picture, mask) for picture in (main or pictures)[:COLUMNS]]


def _map_tile(picture: MapPicture, mask: BoolArray) -> Tile:
    on_paper = np.where(mask[..., None], picture.rgb, np.uint8(255))
    note = picture.notes[0] if picture.notes and picture.scale is None else ""
    bar = None
    if picture.scale is not None:
        low, high, unit = picture.scale
        bar = (number(low, 3), f"{number(high, 3)} {unit}".strip(), imaging.VALUES)
    return Tile(picture.label, on_paper, note, bar, picture.legend)


def _relit_tiles(content: ReportContent) -> list[Tile]:
    if not content.relit:
        return []
    exposure = imaging.common_exposure([relit.image for relit in content.relit])
    return [Tile(relit.title, imaging.display(relit.image, exposure)) for relit in content.relit[:COLUMNS]]


def draw_row(tiles: Sequence[Tile]) -> ByteImage:
    """Up to four tiles side by side."""
    pictures = [_to_column(tile.picture) for tile in tiles]
    tallest = max(picture.shape[0] for picture in pictures)
    noted = any(tile.note or tile.bar or tile.legend for tile in tiles)
    foot = max(FOOT if noted else 20, *(LEGEND_LINE * len(tile.legend) + 16 for tile in tiles))
    canvas = blank(WIDTH, HEAD + tallest + foot)
    for k, (tile, picture) in enumerate(zip(tiles, pictures, strict=True)):
        x = MARGIN + k * (COLUMN + GAP)
        write(canvas, fitted(tile.heading, 15, COLUMN, 600), x, 20, 15, INK, 600)
        paste(canvas, picture, x + (COLUMN - picture.shape[1]) // 2, HEAD)
        _draw_foot(canvas, tile, x, HEAD + tallest)
    return canvas


def _draw_foot(canvas: ByteImage, tile: Tile, x: int, y: int) -> None:
    if tile.bar is not None:
        low, high, colormap = tile.bar
        paste(canvas, colour_bar(COLUMN, 8, colormap), x, y + 8)
        write(canvas, low, x, y + 32, 13, MUTED)
        write(canvas, high, x + COLUMN - text_width(high, 13), y + 32, 13, MUTED)
    elif tile.legend:
        for line, (colour, name) in enumerate(tile.legend):
            paste(canvas, np.full((12, 12, 3), colour, dtype=np.uint8), x, y + 8 + LEGEND_LINE * line)
            write(canvas, fitted(name, 13, COLUMN - 18), x + 18, y + 19 + LEGEND_LINE * line, 13, MUTED)
    elif tile.note:
        write(canvas, fitted(tile.note, 13, COLUMN), x, y + 19, 13, MUTED)


def _to_column(picture: ByteImage) -> ByteImage:
    """Scale to a column's width, or to the tallest a tile may be."""
    factor = min(COLUMN / picture.shape[1], MAX_TILE_HEIGHT / picture.shape[0])
    size = (max(1, round(picture.shape[1] * factor)), max(1, round(picture.shape[0] * factor)))
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_NEAREST if factor > 3 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(np.ascontiguousarray(picture), size, interpolation=method), dtype=np.uint8)

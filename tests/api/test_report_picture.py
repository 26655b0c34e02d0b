"""The summary picture for the README: drawn from the content alone, any part of it may be missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from api.report import ReportContent, write_summary_picture
from api.report.canvas import CANDIDATE, CHOSEN, PAPER, blank, draw_stage, fitted, text_width, write
from api.report.content import MapView, StageView
from api.report.picture import WIDTH, summary_picture
from stage.errors import InputError
from tests.api.report_content import LIGHTS, SIZE, full


def test_picture_is_a_png_of_fixed_width_and_equal_for_equal_content(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_summary_picture(tmp_path / name, full())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    image = cv2.imread(str(tmp_path / "a.png"))
    np.testing.assert_array_equal(image[..., ::-1], summary_picture(full()))
    assert image.shape[1] == WIDTH
    assert 600 < image.shape[0] < 1400


@pytest.mark.parametrize("missing", ["lede", "summary", "stage", "comparisons", "maps", "relit"])
def test_a_missing_part_makes_the_picture_smaller_or_leaves_room(missing: str) -> None:
    whole = summary_picture(full())
    less = summary_picture(replace(full(), **{missing: getattr(ReportContent(title=""), missing)}))
    assert less.shape[0] <= whole.shape[0] + 1 or missing == "comparisons"
    assert less.shape != whole.shape or (less != whole).any()


def test_a_title_alone_and_a_long_one_fit() -> None:
    image = summary_picture(ReportContent(title="Ein sehr langer Titel, " * 20))
    assert image.shape[1] == WIDTH
    assert (image[:, -30:] == 255).all()
    assert (image < 128).any()


def test_maps_without_known_names_are_shown_in_their_order() -> None:
    maps = {f"coefficient {k}": np.full(SIZE, 1.0 + k) for k in range(6)}
    shown = summary_picture(ReportContent(title="t", maps=MapView(maps)))
    assert shown.shape[0] > summary_picture(ReportContent(title="t")).shape[0] + 100


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        write_summary_picture(tmp_path / "nowhere" / "p.png", ReportContent(title="t"))
    assert not list(tmp_path.iterdir())


def test_stage_is_drawn_inside_its_frame_with_both_kinds_of_light() -> None:
    image = draw_stage(StageView(LIGHTS, (3, 11)), 300, 240)
    assert image.shape == (240, 300, 3)
    for colour, count in ((CANDIDATE, len(LIGHTS) - 2), (CHOSEN, 2)):
        found, _ = cv2.connectedComponents((image == colour).all(axis=-1).astype(np.uint8))
        assert 1 <= found - 1 <= count
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert (border == PAPER).all()


def test_words_are_cut_to_their_room() -> None:
    words = "a rather long heading over a narrow picture"
    cut = fitted(words, 15, 120, 600)
    assert cut.endswith("…")
    assert text_width(cut, 15, 600) <= 120
    assert fitted("short", 15, 120) == "short"
    canvas = blank(200, 40)
    end = write(canvas, "91.3\u202f%", 5, 25, 15)
    assert (canvas < 128).any()
    assert 5 < end < 80

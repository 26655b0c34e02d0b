"""RTI sets: pictures paired with lines by name, whatever the names and the white space look like."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.dataset import open_dataset, write_exr
from acquisition.importing import import_dataset, load_any
from stage.errors import InputError

DIRECTIONS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8], [0, -0.6, 0.8]])


def picture(path: Path, value: int, size: tuple[int, int] = (6, 8)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((*size, 3), value, np.uint8))


def rti(folder: Path, names: list[str] | None = None, *, lines: list[str] | None = None, end: str = "\n") -> Path:
    """Make a set whose picture k has the value 10 k, and an ``.lp`` with these lines (default: one per picture)."""
    names = names if names is not None else [f"{k}.png" for k in range(5)]
    for k, name in enumerate(names):
        picture(folder / name, 10 * k)
    if lines is None:
        lines = [f"{name} {d[0]} {d[1]} {d[2]}" for name, d in zip(names, DIRECTIONS, strict=False)]
    (folder / "dirs.lp").write_bytes(end.join([str(len(lines)), *lines, ""]).encode())
    return folder


def values_by_direction(folder: Path, lp: str | None = None) -> dict[tuple[float, ...], int]:
    found = load_any(folder, lp=lp)
    out = {}
    for i, light in enumerate(found.lights):
        assert light.direction is not None
        out[tuple(np.round(light.direction, 6))] = round(float(found.stored(i).max() * 255))
    return out


EXPECTED = {tuple(np.round(d, 6)): 10 * k for k, d in enumerate(DIRECTIONS.astype(float))}


def test_a_set_is_read_in_place(tmp_path: Path) -> None:
    found = load_any(rti(tmp_path / "coin"))
    assert (found.name, found.camera, len(found), found.is_eight_bit) == ("coin", None, 5, True)
    assert {frame.transfer for frame in found.frames} == {"srgb"}
    assert {light.intensity for light in found.lights} == {(1, 1, 1)}
    assert found.mask.all()
    assert found.provenance["format"] == "lp"
    assert values_by_direction(tmp_path / "coin") == EXPECTED
    assert not list((tmp_path / "coin").glob("*.json"))


@settings(deadline=None, max_examples=20)
@given(st.permutations(range(5)))
def test_lines_in_any_order_pair_by_name(tmp_path_factory: pytest.TempPathFactory, order: list[int]) -> None:
    folder = tmp_path_factory.mktemp("rti")
    lines = [f"{k}.png {DIRECTIONS[k][0]} {DIRECTIONS[k][1]} {DIRECTIONS[k][2]}" for k in order]
    assert values_by_direction(rti(folder, lines=lines)) == EXPECTED


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_white_space_of_all_kinds(tmp_path: Path, end: str) -> None:
    names = ["a.png", "b c.png", "d  e.png", "f.png", "1 2 3.png"]
    lines = [
        "a.png\t0\t0\t1",
        "b c.png   .6  0    8e-1",
        "  d  e.png 0 +0.6 0.8   ",
        "f.png \t -0.6 0 0.8\t",
        "1 2 3.png 0 -0.6 0.8",
    ]
    assert values_by_direction(rti(tmp_path / "x", names, lines=lines, end=end)) == EXPECTED
    path = tmp_path / "x/dirs.lp"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"5", b" 5  ", 1) + b"\r\n \r\n")
    assert values_by_direction(tmp_path / "x") == EXPECTED


def test_a_name_is_first_a_path_then_its_last_part(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x", ["sub/0.png", "1.png", "2.png", "sub dir/3.png", "4.png"], lines=[])
    picture(folder / "0.png", 99)  # the path wins over the last part
    lines = [
        "sub/0.png 0 0 1",
        r"C:\photos\of me\1.png .6 0 .8",
        "/home/someone/2.png 0 .6 .8",
        r"sub dir\3.png -.6 0 .8",
        "../../elsewhere/4.png 0 -.6 .8",
    ]
    (folder / "dirs.lp").write_text("\n".join(["5", *lines]))
    assert values_by_direction(folder) == EXPECTED


def test_a_path_out_of_the_folder_is_never_read(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x", lines=["../y.png 0 0 1"])
    picture(tmp_path / "y.png", 1)
    with pytest.raises(
        InputError, match=r"dirs.lp: line 2: no picture '../y.png' beside the .lp, nor one called 'y.png'"
    ):
        load_any(folder)
    (folder / "y.png").symlink_to(tmp_path / "y.png")
    with pytest.raises(InputError, match="line 2: no picture"):
        load_any(folder)


def test_names_in_latin_1_are_read(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x", ["Löwe.png"], lines=[])
    (folder / "dirs.lp").write_bytes("1\nLöwe.png 0 0 1\n".encode("latin-1"))
    assert load_any(folder).frames[0].image == "Löwe.png"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "line 1: expected the count of pictures, got an empty file"),
        ("0.png 0 0 1\n", "line 1: expected the count of pictures, got '0.png 0 0 1'"),
        ("-1\n0.png 0 0 1\n", "line 1: expected the count"),
        ("0\n", "line 1: says 0 pictures"),
        ("2\n0.png 0 0 1\n", "line 1: says 2 pictures, but 1 lines follow"),
        ("1\n0.png 0 0 1\n1.png 0 0 1\n", "line 1: says 1 pictures, but 2 lines follow"),
        ("1\n0.png 0 1\n", "line 2: expected 'name x y z', got '0.png 0 1'"),
        ("1\n0.png 0 0,5 1\n", "line 2: expected 'name x y z'"),
        ("1\n0 0 1\n", "line 2: expected 'name x y z'"),
        ("2\n0.png 0 0 1\n9.png 0 0 1\n", "line 3: no picture '9.png'"),
        ("2\n0.png 0 0 1\n./0.png 1 0 1\n", "line 3: the picture '0.png' already belongs to line 2"),
        ("1\n0.png 0 0 0\n", "line 2: light.direction: must not be zero"),
        ("1\n0.png nan 0 1\n", "line 2: light.direction: expected three finite numbers"),
        ("1\n0.png 0 inf 1\n", "line 2: light.direction: expected three finite numbers"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, text: str, fault: str) -> None:
    folder = rti(tmp_path / "x")
    (folder / "dirs.lp").write_text(text)
    with pytest.raises(InputError) as caught:
        load_any(folder)
    assert str(caught.value).startswith(f"{folder / 'dirs.lp'}: {fault}")


def test_which_lp_is_an_option(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x")
    (folder / "other.LP").write_text("1\n3.png 0 0 1\n")
    with pytest.raises(InputError, match=r"x: lp: there are several \(dirs.lp, other.LP\); say which"):
        load_any(folder)
    assert values_by_direction(folder, "dirs.lp") == EXPECTED
    assert values_by_direction(folder, "other.LP") == {(0, 0, 1): 30}
    assert values_by_direction(folder / "dirs.lp") == EXPECTED
    with pytest.raises(InputError, match=r"none\.lp: lp: no such file"):
        load_any(folder, lp="none.lp")
    with pytest.raises(InputError, match="lp: goes with the format 'lp' only"):
        load_any(folder, lp="dirs.lp", format="psbox")


def test_the_set_lies_where_its_lp_lies(tmp_path: Path) -> None:
    rti(tmp_path / "x/inner")
    assert values_by_direction(tmp_path / "x", "inner/dirs.lp") == EXPECTED
    with pytest.raises(InputError, match="x: format: no set of photographs is recognised; looked for dataset"):
        load_any(tmp_path / "x")
    with pytest.raises(InputError, match=r"x: lp: the folder holds no \.lp file"):
        load_any(tmp_path / "x", format="lp")


def test_mask_and_normals_are_taken_where_they_are(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x")
    mask = np.zeros((6, 8), np.uint8)
    mask[1:5, 1:7] = 255
    cv2.imwrite(str(folder / "mask.png"), mask)
    normal = np.array([0.48, 0.64, 0.6])
    stored = np.zeros((6, 8, 3), np.uint16)
    stored[mask > 0] = np.rint((normal * 0.5 + 0.5) * 65535)
    cv2.imwrite(str(folder / "normals.png"), stored[..., ::-1])
    found = load_any(folder)
    assert len(found) == 5
    assert_array_equal(found.mask, mask > 0)
    assert found.normals is not None
    assert_allclose(found.normals[found.mask], np.tile(normal, (24, 1)), atol=5e-5)
    assert not found.normals[~found.mask].any()


def test_a_photograph_called_normals_is_a_photograph(tmp_path: Path) -> None:
    found = load_any(rti(tmp_path / "x", ["normals.png", "mask.png"]))
    assert len(found) == 2
    assert found.normals is None
    assert found.mask.all()


def test_normals_and_masks_that_are_none_are_refused(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x")
    photograph = np.random.default_rng(0).integers(0, 90, (6, 8, 3), dtype=np.uint8)
    cv2.imwrite(str(folder / "normals.png"), photograph)
    with pytest.raises(InputError, match=r"normals\.png: normals: holds no unit vectors"):
        load_any(folder)
    cv2.imwrite(str(folder / "normals.png"), photograph[..., 0])
    with pytest.raises(InputError, match=r"normals\.png: normals: expected an 8- or 16-bit picture of three channels"):
        load_any(folder)
    cv2.imwrite(str(folder / "normals.png"), np.full((3, 3, 3), (255, 128, 128), np.uint8))
    with pytest.raises(InputError, match=r"geometry\.normals: expected 8 x 6 pixels like the images, got 3 x 3"):
        load_any(folder)
    (folder / "normals.png").unlink()
    cv2.imwrite(str(folder / "mask.png"), np.zeros((6, 8), np.uint8))
    with pytest.raises(InputError, match=r"geometry\.mask: is empty"):
        load_any(folder)
    (folder / "mask.png").write_text("no picture")
    with pytest.raises(InputError, match=r"mask\.png: mask: is not an EXR, PNG"):
        load_any(folder)


def test_pictures_of_two_sizes_are_refused(tmp_path: Path) -> None:
    folder = rti(tmp_path / "x")
    picture(folder / "3.png", 1, (8, 6))
    with pytest.raises(InputError, match=r"frames\[3\].image: '3.png' is 6 x 8 pixels, expected 8 x 6"):
        load_any(folder)


def test_the_transfer_function_is_chosen_by_the_file(tmp_path: Path) -> None:
    folder = tmp_path / "x"
    picture(folder / "byte.png", 100)
    cv2.imwrite(str(folder / "word.png"), np.full((6, 8, 3), 30000, np.uint16))
    write_exr(folder / "free.exr", np.ones((6, 8, 3)))
    (folder / "a.lp").write_text("3\nbyte.png 0 0 1\nword.png 0 1 1\nfree.exr 1 0 1\n")
    assert [frame.transfer for frame in load_any(folder).frames] == ["srgb", "linear", "linear"]
    (folder / "a.lp").write_text("2\nbyte.png 0 0 1\nword.png 0 1 1\n")
    assert [frame.transfer for frame in load_any(folder, transfer="gamma:2.2").frames] == ["gamma:2.2"] * 2
    with pytest.raises(InputError, match="x: transfer: expected 'linear', 'srgb' or 'gamma:G'"):
        load_any(folder, transfer="log")


def test_importing_copies_files_as_they_are(tmp_path: Path) -> None:
    folder = rti(tmp_path / "coin")
    cv2.imwrite(str(folder / "mask.png"), np.pad(np.full((4, 6), 255, np.uint8), 1))
    found = import_dataset(folder, tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["coin", "out"]
    again = open_dataset(tmp_path / "out")
    foreign = load_any(folder)
    for i in range(5):
        assert found.path(i).read_bytes() == foreign.path(i).read_bytes()
    assert again.lights == foreign.lights
    assert_array_equal(again.stack(range(5)), foreign.stack(range(5)))
    assert_array_equal(again.mask, foreign.mask)
    assert again.provenance == {"format": "lp", "lights": "dirs.lp", "pictures": [f"{k}.png" for k in range(5)]}


Break = Callable[[Path], object]


@pytest.mark.parametrize(
    "damage",
    [
        lambda f: (f / "2.png").unlink(),
        lambda f: (f / "2.png").write_bytes((f / "2.png").read_bytes()[:50]),
        lambda f: (f / "2.png").write_bytes((f / "2.png").read_bytes().replace(b"IDAT", b"IDAT\x07")),
        lambda f: (f / "dirs.lp").write_text("7\n"),
    ],
)
def test_an_import_that_fails_leaves_nothing(tmp_path: Path, damage: Break) -> None:
    folder = rti(tmp_path / "coin")
    damage(folder)
    with pytest.raises(InputError):
        import_dataset(folder, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["coin"]


def test_an_import_overwrites_nothing(tmp_path: Path) -> None:
    folder = rti(tmp_path / "coin")
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(InputError, match="coin: output: the folder exists and is not empty"):
        import_dataset(folder, folder)
    assert sorted(path.name for path in folder.iterdir()) == before

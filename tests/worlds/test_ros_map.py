"""ROS map_server maps: what a pixel means, and what is refused in which words."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from worlds.errors import WorldError
from worlds.formats.image import read_image
from worlds.formats.ros_map import FREE, OCCUPIED, UNKNOWN, pool_blocked, read_ros_map

YAML = """\
image: map.pgm
resolution: 0.5
origin: [-1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
SHARED = Path(__file__).parents[3] / "shared/data/ros"


def pgm(levels: np.ndarray, white: int = 255) -> bytes:
    """A binary PGM."""
    rows, columns = levels.shape
    kind = np.uint8 if white < 256 else ">u2"
    return b"P5\n# made here\n%d %d\n%d\n" % (columns, rows, white) + levels.astype(kind).tobytes()


def write(folder: Path, levels: object, text: str = YAML, white: int = 255) -> Path:
    """A map in a folder; the path of its YAML file."""
    (folder / "map.pgm").write_bytes(pgm(np.atleast_2d(np.asarray(levels)), white))
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def state(folder: Path, levels: object, text: str = YAML, white: int = 255) -> list[list[int]]:
    """The pixels' states, row 0 at the bottom."""
    return read_ros_map(write(folder, levels, text, white)).state.tolist()


def refusal(path: Path) -> list[str]:
    """What is said about a map."""
    with pytest.raises(WorldError) as caught:
        read_ros_map(path)
    return list(caught.value.lines)


# What a pixel means


def test_the_bottom_row_of_the_image_is_the_first(tmp_path: Path) -> None:
    """Row 0 of an image is its top; the origin is the lower left pixel (page 7)."""
    assert state(tmp_path, [[0, 255], [255, 205]]) == [[FREE, UNKNOWN], [OCCUPIED, FREE]]


def test_thresholds_are_strict(tmp_path: Path) -> None:
    """Exactly at a threshold is unknown; one level further is occupied or free."""
    text = YAML.replace("0.65", "0.6").replace("0.196", "0.2")
    # white 100: level 40 is occ 0.6, level 80 is occ 0.2
    found = state(tmp_path, [[39, 40, 41, 79, 80, 81]], text, white=100)
    assert found == [[OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, FREE]]


def test_negate_turns_shades_around(tmp_path: Path) -> None:
    """With negate white is occupied; the thresholds keep their meaning."""
    text = YAML.replace("negate: 0", "negate: 1")
    assert state(tmp_path, [[0, 255, 128]], text) == [[FREE, OCCUPIED, UNKNOWN]]


def test_scale_takes_what_lies_between_for_occupied(tmp_path: Path) -> None:
    """In mode scale a grey pixel is partly occupied, not unknown; see-through ones are unknown."""
    text = YAML + "mode: scale\n"
    assert state(tmp_path, [[0, 128, 255]], text) == [[OCCUPIED, OCCUPIED, FREE]]
    pixels = np.array([[[255, 255, 255, 255], [255, 255, 255, 0], [0, 0, 0, 255]]], dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text(text.replace("map.pgm", "map.png"))
    assert read_ros_map(tmp_path / "map.yaml").state.tolist() == [[FREE, UNKNOWN, OCCUPIED]]


def test_raw_takes_the_level_for_per_cent(tmp_path: Path) -> None:
    """In mode raw a level is occupancy in per cent, above 100 unknown; negate changes nothing."""
    for negate in ("0", "1"):
        text = YAML.replace("negate: 0", f"negate: {negate}") + "mode: raw\n"
        found = state(tmp_path, [[0, 19, 20, 65, 66, 100, 101, 255]], text)
        assert found == [[FREE, FREE, UNKNOWN, UNKNOWN, OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN]]


def test_unknown_is_blocked_unless_told_otherwise(tmp_path: Path) -> None:
    """Nobody drives where nothing is known; an option frees it, never what is occupied."""
    ros_map = read_ros_map(write(tmp_path, [[0, 205, 255]]))
    assert ros_map.blocked().tolist() == [[True, True, False]]
    assert ros_map.blocked(unknown_is_free=True).tolist() == [[True, False, False]]
    assert ros_map.size_m == (1.5, 0.5)
    assert not ros_map.state.flags.writeable


@pytest.mark.parametrize("kind", ["P2", "P5", "P5 16 bit", "L", "RGB", "1", "P", "LA", "I;16"])
def test_every_kind_of_image_says_the_same(tmp_path: Path, kind: str) -> None:
    """PGM in text, bytes and 16 bits, and PNG in its modes: black, white, white, black."""
    levels = np.array([[0, 255], [255, 0]], dtype=np.uint8)
    path = tmp_path / "map.pgm"
    match kind:
        case "P2":
            path.write_text("P2 # text\n2 2\n255\n0 255\n255 # end\n0")
        case "P5":
            path.write_bytes(pgm(levels))
        case "P5 16 bit":
            path.write_bytes(pgm(levels.astype(int) * 257, 65535))
        case "I;16":
            Image.fromarray(levels.astype(np.uint16) * 257).save(path, format="PNG")
        case _:
            Image.fromarray(levels).convert(kind).save(path, format="PNG")
    (tmp_path / "map.yaml").write_text(YAML)
    found = read_ros_map(tmp_path / "map.yaml").state.tolist()
    assert found == [[FREE, OCCUPIED], [OCCUPIED, FREE]]


# Cells


def test_a_cell_is_blocked_if_any_pixel_in_it_is() -> None:
    """Max-pooling: one speck of 5 cm blocks its cell of 20 cm and no other."""
    pixels = np.zeros((8, 8), dtype=bool)
    pixels[5, 2] = True
    assert np.argwhere(pool_blocked(pixels, 0.05, 0.2)).tolist() == [[1, 0]]


def test_a_pixel_between_two_cells_blocks_both() -> None:
    """Cells that are no whole number of pixels lose no obstacle."""
    pixels = np.zeros((5, 10), dtype=bool)
    pixels[0, 2] = True  # 0.2 to 0.3 m, cells are 0.25 m
    found = pool_blocked(pixels, 0.1, 0.25)
    assert found.tolist() == [[True, True, False, False], [False] * 4]


def test_cells_that_reach_beyond_the_map_are_blocked() -> None:
    """Beyond the image nothing is known."""
    found = pool_blocked(np.zeros((5, 4), dtype=bool), 1.0, 2.0)
    assert found.tolist() == [[False, False], [False, False], [True, True]]
    assert pool_blocked(np.zeros((3, 3), dtype=bool), 0.1, 0.1).sum() == 0  # rounding adds none


# What is refused


REFUSED = {
    "yaw": ("0.0]", "0.5]", "map.yaml:3: origin: yaw 0.5 rad"),
    "resolution in millimetres": ("0.5", "50", "millimetres? then write 0.05"),
    "resolution in centimetres": ("0.5", "5.0", "centimetres? then write 0.05"),
    "resolution zero": ("resolution: 0.5", "resolution: 0", "more than 0"),
    "resolution as text": ("0.5", '"half"', "is no number"),
    "resolution not a number": ("0.5", ".nan", "is no number"),
    "origin of two": ("2.0, 0.0]", "2.0]", "give metres, metres, radians"),
    "threshold in per cent": ("0.65", "65", "per cent? then write 0.65"),
    "thresholds crossed": ("0.65", "0.1", "free_thresh: 0.196 is above occupied_thresh"),
    "negate of two": ("negate: 0", "negate: 2", "neither 0 nor 1"),
    "missing": ("negate: 0\n", "", "negate: is missing"),
    "misspelt": ("occupied_thresh", "ocupied_thresh", "did you mean 'ocupied_thresh'"),
    "unknown mode": ("negate: 0", "negate: 0\nmode: trinery", "did you mean 'trinary'"),
    "given twice": ("negate: 0", "negate: 0\nnegate: 1", "map.yaml:5: negate: is given in line 4"),
    "image elsewhere": ("map.pgm", "../map.pgm", "leads out of the folder"),
    "image absent": ("map.pgm", "other.pgm", "there is no such image"),
    "python object": ("0.5", "!!python/object/apply:os.system ['true']", "only plain values"),
    "no mapping": (YAML, "- 1\n- 2\n", "no list of `key: value`"),
    "broken": ("[-1.0", "[-1.0]]", "not valid YAML"),
    "empty": (YAML, "", "map.yaml:1: is no list"),
    "nested": ("0.5", "[" * 2000 + "]" * 2000, "nested too deeply"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_yaml_file_is_refused_in_words(tmp_path: Path, case: str) -> None:
    """File, line, value and remedy; one message for one mistake."""
    old, new, words = REFUSED[case]
    assert old in YAML
    lines = refusal(write(tmp_path, [[255]], YAML.replace(old, new, 1)))
    assert len(lines) == 1, lines
    assert words in lines[0]


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    """Three mistakes, three lines, in the file's order."""
    text = YAML.replace("0.5", "-1").replace("0.0]", "1.0]").replace("negate: 0", "negate: no way")
    lines = refusal(write(tmp_path, [[255]], text))
    assert [line.split("map.yaml:")[1].split(":")[0] for line in lines] == ["2", "3", "4"]


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    """Nothing outside the YAML file's folder is read for a relative name."""
    inner = tmp_path / "inner"
    inner.mkdir()
    path = write(inner, [[255]])
    (inner / "map.pgm").rename(tmp_path / "secret.pgm")
    (inner / "map.pgm").symlink_to(tmp_path / "secret.pgm")
    assert "leads out of the folder" in refusal(path)[0]
    assert read_ros_map(path, image=tmp_path / "secret.pgm").state.tolist() == [[FREE]]


def test_aliases_that_multiply_are_harmless(tmp_path: Path) -> None:
    """A YAML bomb (aliases of aliases) is neither expanded nor printed."""
    bomb = "a: &a [1, 1]\n" + "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [*{chr(97 + k)}, *{chr(97 + k)}]\n" for k in range(24)
    )
    lines = refusal(write(tmp_path, [[255]], bomb + YAML.replace("0.5", "*y")))
    assert len(lines) == 1
    assert len(lines[0]) < 300


def png_claiming(columns: int, rows: int) -> bytes:
    """A PNG of a few bytes whose header claims a size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0")) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


BAD_IMAGES = {
    "cut short": (pgm(np.zeros((4, 4)))[:-5], "cut short: it has 2 whole rows of 4 pixels"),
    "gigapixels": (b"P5 100000 100000 255\n", "claims 100000 x 100000 pixels"),
    "gigapixels in text": (b"P2 100000 100000 255\n0", "claims 100000 x 100000 pixels"),
    "absurd digits": (b"P5 99999999999999999999 1 255\n", "has no width"),
    "gigapixels in PNG": (png_claiming(60_000, 60_000), "claims 60000 x 60000 pixels"),
    "PNG cut short": (png_claiming(40, 40), "cut short or damaged"),
    "PNG header only": (b"\x89PNG\r\n\x1a\n", "cut short or damaged"),
    "no largest level": (b"P5 4 4\n", "has no largest level"),
    "largest level zero": (b"P5 1 1 0\n\0", "outside 1 to 65535"),
    "level too large": (b"P5 2 1 100\n\x00\xff", "row 0, column 1: level 255 is above"),
    "text level too large": (b"P2 2 1 100\n0 70000", "row 0, column 1: level 70000 is above"),
    "strange text": (b"P2 2 1 100\n0 x9", "is no level of grey"),
    "too few text levels": (b"P2 2 2 100\n0 10 20 ", "cut short"),
    "empty": (b"", "is empty"),
    "JPEG": (b"\xff\xd8\xff\xe0 1234", "no PGM (P2, P5) or PNG"),
}


@pytest.mark.parametrize("case", BAD_IMAGES)
def test_a_wrong_image_is_refused_in_words(tmp_path: Path, case: str) -> None:
    """One sentence that names the image; no memory is taken for what a header claims."""
    data, words = BAD_IMAGES[case]
    path = write(tmp_path, [[255]])
    (tmp_path / "map.pgm").write_bytes(data)
    (line,) = refusal(path)
    assert "map.pgm: " in line
    assert words in line


def test_a_limit_on_pixels_holds_for_honest_images_too(tmp_path: Path) -> None:
    """A smaller limit can be asked for."""
    write(tmp_path, np.zeros((10, 10)))
    with pytest.raises(WorldError, match="at most 99 are read"):
        read_image(tmp_path / "map.pgm", max_pixels=99)


@pytest.mark.parametrize(
    ("name", "size", "free"),
    [("warehouse", (1674, 1006), 1422292), ("tb3_sandbox", (384, 384), 7903)],
)
def test_real_maps(name: str, size: tuple[int, int], free: int) -> None:
    """Two maps of real robots are read as their makers meant them."""
    if not SHARED.exists():
        pytest.skip("../shared/data/ros is not here")
    ros_map = read_ros_map(SHARED / f"{name}.yaml")
    assert ros_map.state.shape == size
    assert int((ros_map.state == FREE).sum()) == free

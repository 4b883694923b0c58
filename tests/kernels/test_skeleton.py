"""Thinning and the graph of a centerline: small drawings checked by eye, and plain twins on random lines."""

import heapq
import itertools
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import BoolArray, Int32Array, StructuredArray, UInt8Array
from interloc.detection.image import BinaryImage
from interloc.kernels import skeleton as sk
from interloc.kernels.skeleton import thin
from tests.images import binary_image, cross

Pixel = tuple[int, int]


def drawing(*lines: str) -> BinaryImage:
    """Make an image of text: a point is clear, anything else is set."""
    return binary_image(np.array([[mark != "." for mark in line] for line in lines], np.uint8))


def joined(image: BinaryImage) -> dict[Pixel, set[Pixel]]:
    rows, cols = image.pixels()
    pixels = list(zip(rows.tolist(), cols.tolist(), strict=True))
    neighbours = sk.neighbours_of(image.words, rows, cols)
    return {pixel: {pixels[q] for q in row if q >= 0} for pixel, row in zip(pixels, neighbours.tolist(), strict=True)}


def degrees(image: BinaryImage) -> list[str]:
    """Draw how many pixels each one is joined to."""
    marks = np.full((image.height, image.width), ".")
    for (r, c), others in joined(image).items():
        marks[r, c] = str(len(others))
    return ["".join(line) for line in marks]


def plain_joined(image: UInt8Array) -> dict[Pixel, set[Pixel]]:
    """Join pixels side by side, and diagonally where no third one joins them side by side."""
    pixels = {(int(r), int(c)) for r, c in np.argwhere(image)}
    result = {}
    for r, c in pixels:
        others = {(r + dr, c + dc) for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1))} & pixels
        for dr, dc in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            if (r + dr, c + dc) in pixels and not {(r + dr, c), (r, c + dc)} & pixels:
                others.add((r + dr, c + dc))
        result[r, c] = others
    return result


def thinned_blobs(seed: int) -> tuple[BinaryImage, BinaryImage]:
    """Return the axis of random smooth shapes, and the shapes."""
    noise = np.random.default_rng(seed).normal(size=(130, 130)).astype(np.float32)
    shape = binary_image((cv2.GaussianBlur(noise, (0, 0), 4) > 0).astype(np.uint8))
    line = BinaryImage(shape.words.copy(), 130, 130, 1.0)
    thin(line.words)
    return line, shape


def graph(image: BinaryImage) -> tuple[Int32Array, Int32Array, Int32Array]:
    rows, cols = image.pixels()
    return rows, cols, sk.neighbours_of(image.words, rows, cols)


# --- neighbours ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("....", ".#..", "...."), ("....", ".0..", "....")),
        ((".....", ".###.", "....."), (".....", ".121.", ".....")),
        (("#....", ".##..", "...#."), ("1....", ".22..", "...1.")),
        (("##...", ".##..", "..##."), ("12...", ".22..", "..21.")),  # a staircase is a line
        (("#...", "#...", "####"), ("1...", "2...", "2221")),  # so is a corner
        (("..#..", "..#..", "#####"), ("..1..", "..2..", "12321")),
        (("#...#", ".#.#.", "..#..", "..#.."), ("1...1", ".2.2.", "..3..", "..1..")),
        (("..#..", "..#..", "#####", "..#..", "..#.."), ("..1..", "..2..", "12421", "..2..", "..1..")),
        (("#...#", ".#.#.", "..#..", ".#.#.", "#...#"), ("1...1", ".2.2.", "..4..", ".2.2.", "1...1")),
        (("#..#", ".##.", ".##.", "#..#"), ("1..1", ".33.", ".33.", "1..1")),  # four lines meet at a block
        ((".##.", ".##."), (".22.", ".22.")),
        (("###", "#.#", "###"), ("222", "2.2", "222")),
    ],
)
def test_lines_corners_and_junctions_are_told_apart(lines: tuple[str, ...], expected: tuple[str, ...]) -> None:
    assert degrees(drawing(*lines)) == list(expected)


@given(st.integers(0, 2**32 - 1), st.integers(1, 20), st.sampled_from([1, 2, 63, 64, 65, 128]), st.floats(0, 1))
@settings(deadline=None, max_examples=60)
def test_neighbours_are_those_of_the_plain_twin(seed: int, height: int, width: int, share: float) -> None:
    image = (np.random.default_rng(seed).random((height, width)) < share).astype(np.uint8)
    packed = binary_image(image)
    expected = plain_joined(image)
    assert joined(packed) == expected
    rows, cols, neighbours = graph(packed)
    assert sk.degrees_of(neighbours).tolist() == [len(expected[p]) for p in zip(rows, cols, strict=True)]


# --- width and clearing ----------------------------------------------------------------------------------------------


def test_width_is_twice_the_way_to_the_nearest_gap() -> None:
    road = np.zeros((40, 40), np.uint8)
    road[10:19, :] = 1  # nine pixels: the gap is five from the middle one
    rows, cols = np.array([14, 14, 11], np.int32), np.array([20, 0, 20], np.int32)
    words = binary_image(road).words
    assert sk.widths_at(words, rows, cols, 40, 200).tolist() == [10, 10, 4]
    assert sk.widths_at(words, rows, cols, 40, 3).tolist() == [6, 6, 4]


# --- spurs -----------------------------------------------------------------------------------------------------------


def comb(spur: int) -> tuple[BinaryImage, BinaryImage]:
    """Return a line across with a spur upwards, in a road 21 pixels wide (22 to the middles of the gaps)."""
    line, road = np.zeros((2, 100, 100), np.uint8)
    line[50, :] = 1
    line[50 - spur : 50, 50] = 1
    road[40:61, :] = 1
    return binary_image(line), binary_image(road)


def kept(line: BinaryImage, road: BinaryImage, widths: float, border: int) -> list[Pixel]:
    rows, cols, neighbours = graph(line)
    keep = sk.prune_spurs(rows, cols, neighbours, road.words, line.height, widths, 200, border)
    return list(zip(rows[keep].tolist(), cols[keep].tolist(), strict=True))


@pytest.mark.parametrize(
    ("spur", "widths", "stays"),
    [(1, 1.0, False), (21, 1.0, False), (22, 1.0, True), (35, 1.0, True), (15, 0.5, True), (15, 0.69, False)],
)
def test_spur_shorter_than_the_road_is_wide_is_removed(spur: int, widths: float, stays: bool) -> None:
    line, road = comb(spur)
    pixels = kept(line, road, widths, 5)
    assert [(50, c) for c in range(100)] == [p for p in pixels if p[0] == 50]
    assert len(pixels) == (100 + spur if stays else 100)


def test_tip_at_the_border_is_kept() -> None:
    line, road = comb(15)
    assert len(kept(line, road, 1.0, 35)) == 100
    assert len(kept(line, road, 1.0, 36)) == 115


def test_of_two_spurs_at_the_end_of_a_road_one_becomes_its_end() -> None:
    image = np.zeros((100, 100), np.uint8)
    image[50, :51] = 1
    for i in range(1, 9):
        image[50 - i, 50 + i] = image[50 + i, 50 + i] = 1
    road = np.zeros((100, 100), np.uint8)
    road[40:61, :62] = 1
    pixels = kept(binary_image(image), binary_image(road), 1.0, 5)
    assert len(pixels) == 51 + 8


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 1.0, 2.0]))
@settings(deadline=None, max_examples=20)
def test_pruning_keeps_every_piece_and_leaves_no_short_spur(seed: int, widths: float) -> None:
    line, shape = thinned_blobs(seed)
    rows, cols, neighbours = graph(line)
    keep = sk.prune_spurs(rows, cols, neighbours, shape.words, 130, widths, 200, 12)
    pieces = cv2.connectedComponents(line.to_array(), connectivity=8)[0]
    sk.clear_pixels(line.words, rows[~keep], cols[~keep])
    assert cv2.connectedComponents(line.to_array(), connectivity=8)[0] == pieces
    graph_of = plain_joined(line.to_array())
    for tip, length, junction in plain_spurs(graph_of):
        if min(*tip, 129 - tip[0], 129 - tip[1]) >= 12:
            width = 2 * plain_gap(shape.to_array(), junction)
            assert length >= widths * width - 1e-9


def plain_gap(shape: UInt8Array, pixel: Pixel) -> float:
    rows, cols = np.nonzero(shape == 0)
    return float(np.hypot(rows - pixel[0], cols - pixel[1]).min())


def plain_spurs(graph_of: dict[Pixel, set[Pixel]]) -> list[tuple[Pixel, float, Pixel]]:
    """Return tip, length and junction of each dead end."""
    spurs = []
    for tip, others in graph_of.items():
        if len(others) != 1:
            continue
        length, last, here = 0.0, tip, next(iter(others))
        length += math.dist(last, here)
        while len(graph_of[here]) == 2:
            (onward,) = graph_of[here] - {last}
            length += math.dist(here, onward)
            last, here = here, onward
        if len(graph_of[here]) >= 3:
            spurs.append((tip, length, here))
    return spurs


# --- pieces and distances along the line -----------------------------------------------------------------------------


def test_pieces_are_numbered_in_the_order_of_their_starts() -> None:
    image = drawing("###.###.##", "..........", "###.......")  # pixels 0-2, 3-5, 6-7, 8-10
    _, _, neighbours = graph(image)
    allowed = np.ones(11, np.bool_)
    labels, count = sk.label_pieces(neighbours, allowed, np.array([9, 0, 8, 4], np.int32))
    assert count == 3
    assert labels.tolist() == [1, 1, 1, 2, 2, 2, -1, -1, 0, 0, 0]


def test_piece_ends_where_pixels_are_not_allowed() -> None:
    _, _, neighbours = graph(drawing("########"))
    allowed = np.array([1, 1, 0, 1, 1, 1, 0, 1], np.bool_)
    labels, count = sk.label_pieces(neighbours, allowed, np.array([2, 4, 7], np.int32))
    assert count == 2
    assert labels.tolist() == [-1, -1, -1, 0, 0, 0, -1, 1]


def plain_grow(graph_of: dict[Pixel, set[Pixel]], sources: list[Pixel], reach: list[float]) -> set[Pixel]:
    """Return what lies within the reach of each source in turn (Dijkstra)."""
    found: set[Pixel] = set()
    for source, limit in zip(sources, reach, strict=True):
        distance = {source: 0.0}
        queue = [(0.0, source)]
        while queue:
            so_far, pixel = heapq.heappop(queue)
            for other in graph_of[pixel]:
                far = so_far + math.dist(pixel, other)
                if far <= limit + 1e-9 and far < distance.get(other, math.inf):
                    distance[other] = far
                    heapq.heappush(queue, (far, other))
        found |= set(distance)
    return found


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
@settings(deadline=None, max_examples=20)
def test_reach_is_that_of_the_plain_twin(seed: int, count: int) -> None:
    line, _ = thinned_blobs(seed)
    rows, cols, neighbours = graph(line)
    generator = np.random.default_rng(seed)
    sources = generator.integers(0, rows.size, count, np.int32)
    reach = generator.uniform(0, 60, count)
    near = sk.grow_from(rows, cols, neighbours, sources, reach)
    pixels = list(zip(rows.tolist(), cols.tolist(), strict=True))
    expected = plain_grow(plain_joined(line.to_array()), [pixels[s] for s in sources], reach.tolist())
    assert {pixel for pixel, is_near in zip(pixels, near, strict=True) if is_near} == expected


# --- pieces around a candidate ---------------------------------------------------------------------------------------


def trace(
    image: BinaryImage, *candidates: Pixel, inner: float = 10.0, outer: float = 60.0
) -> tuple[Int32Array, BoolArray, StructuredArray]:
    """Trace the pieces around the first candidate; they end 5 pixels before another one."""
    first, others = np.array(candidates[0], np.float64), np.array(candidates[1:], np.float64).reshape(-1, 2)
    return sk.trace_branches(*graph(image), first, others, inner, outer, 5.0)


def lengths(table: StructuredArray) -> list[int]:
    found: list[int] = (table["end"] - table["begin"]).tolist()
    return found


def test_crossing_lines_have_four_pieces_from_circle_to_circle() -> None:
    *_, table = trace(binary_image(cross()), (100, 100))
    # The ring is open: pixels 11 to 59 away, their mean 35 away.
    assert table["start"].tolist() == [[89, 100], [100, 89], [100, 111], [111, 100]]
    assert table["mean"].tolist() == [[65, 100], [100, 65], [100, 135], [135, 100]]
    assert lengths(table) == [49] * 4
    assert table["reach"].tolist() == [59] * 4
    assert not table["at_candidate"].any()


def test_main_path_leads_to_the_farthest_pixel_past_what_leads_aside() -> None:
    image = cross()
    image[85:100, 120] = 1  # a stub at the right arm
    traced, is_main, table = trace(binary_image(image), (100, 100))
    rows, cols, _ = graph(binary_image(image))
    right = slice(table["begin"][2], table["end"][2])
    assert cols[traced[right]].max() == 159
    assert rows[traced[right]].min() == 85
    main = traced[right][is_main[right]]
    assert sorted(cols[main]) == list(range(111, 160))
    assert np.abs(rows[main] - 100).max() <= 1  # where the stub leaves, the thinned line may yield by a pixel


def test_a_star_of_forty_rays_has_forty_pieces() -> None:
    image = np.zeros((801, 801), np.uint8)
    for angle in np.arange(40) * np.pi / 20:
        for r in np.arange(100, 390, 0.5):
            image[round(400 + r * math.sin(angle)), round(400 + r * math.cos(angle))] = 1
    *_, table = trace(binary_image(image), (400, 400), inner=150.0, outer=380.0)
    assert len(table) == 40


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
@settings(deadline=None, max_examples=20)
def test_pieces_around_a_candidate_are_those_of_the_plain_twin(seed: int, count: int) -> None:
    line, shape = thinned_blobs(seed)
    pixels = list(zip(*(axis.tolist() for axis in line.pixels()), strict=True))
    picks = np.random.default_rng(seed).choice(len(pixels), count, replace=False)
    candidates = [pixels[i] for i in picks]
    traced, is_main, table = trace(line, *candidates, inner=8.0, outer=30.0)
    neighbours_of = plain_joined(line.to_array())
    expected = plain_pieces(neighbours_of, candidates, 8.0, 30.0, 5.0)
    for row, (piece, blocked) in zip(table, expected, strict=True):
        assert {pixels[i] for i in traced[row["begin"] : row["end"]]} == piece
        main = [pixels[i] for i in traced[row["begin"] : row["end"]][is_main[row["begin"] : row["end"]]]]
        assert all(q in neighbours_of[p] for p, q in itertools.pairwise(main))
        away = {pixel: math.dist(pixel, candidates[0]) for pixel in piece}
        assert away[int(row["start"][0]), int(row["start"][1])] == min(away.values())
        assert row["reach"] == pytest.approx(max(away.values()))
        assert row["mean"] == pytest.approx(np.mean(sorted(piece), axis=0))
        assert row["at_candidate"] == blocked
    rows, cols = line.pixels()
    each = [traced[row["begin"] : row["end"]] for row in table]
    widths = [sk.widths_at(shape.words, rows[piece[::4]], cols[piece[::4]], 130, 50) for piece in each]
    for i, area in enumerate(len(piece) * np.mean(width) for piece, width in zip(each, widths, strict=True)):
        for minimum in (0.999 * area, 1.001 * area):
            asked = np.arange(len(each)) == i
            enough = sk.have_surface(shape.words, rows, cols, traced, table, asked, 4, 130, 50, minimum)
            np.testing.assert_array_equal(enough, asked & (area > minimum))


def plain_pieces(
    graph_of: dict[Pixel, set[Pixel]], candidates: list[Pixel], inner: float, outer: float, stop: float
) -> list[tuple[set[Pixel], bool]]:
    """Return the pieces of the annulus around the first candidate that touch its inner disc."""
    first, *others = candidates
    ring = {p for p in graph_of if inner < math.dist(p, first) < outer}
    blocked = {p for p in ring if any(math.dist(p, other) < stop for other in others)}
    pieces: list[tuple[set[Pixel], bool]] = []
    taken: set[Pixel] = set()  # a pixel belongs to the first piece that reaches it
    for start in sorted(ring):
        if start in taken:
            continue
        if all(math.dist(q, first) > inner for q in graph_of[start]):
            continue
        piece, stack, at_candidate = {start}, [start], False
        while stack:
            for q in graph_of[stack.pop()] & ring:
                if q in blocked and q not in piece and q not in taken:
                    at_candidate = True
                elif q not in piece and q not in taken:
                    piece.add(q)
                    stack.append(q)
        pieces.append((piece, at_candidate))
        taken |= piece
    return pieces


WIDTHS = [1, 2, 3, 63, 64, 65, 128]


def our_thin(image: UInt8Array) -> UInt8Array:
    packed = binary_image(image)
    thin(packed.words)
    return packed.to_array()


def plain_thin(image: UInt8Array) -> UInt8Array:
    """Thin by the definition: two sub-iterations in turn, each deletes at once, until neither deletes any.

    Zhang and Suen, "A fast parallel algorithm for thinning digital patterns", CACM 27 (1984). P2 is above the pixel P1,
    then clockwise. Delete P1 if 2 <= B(P1) <= 6, A(P1) = 1, and P2 P4 P6 = P4 P6 P8 = 0 in the first,
    P2 P4 P8 = P2 P6 P8 = 0 in the second sub-iteration.
    """
    padded = np.pad(image.astype(np.int64), 1)
    while True:
        deleted = 0
        for first in (True, False):
            p2, p3, p4 = padded[:-2, 1:-1], padded[:-2, 2:], padded[1:-1, 2:]
            p5, p6, p7 = padded[2:, 2:], padded[2:, 1:-1], padded[2:, :-2]
            p8, p9 = padded[1:-1, :-2], padded[:-2, :-2]
            ring = [p2, p3, p4, p5, p6, p7, p8, p9, p2]
            neighbours = np.sum(ring[:8], axis=0)
            transitions = np.sum([(ring[i] == 0) & (ring[i + 1] == 1) for i in range(8)], axis=0)
            sides = (p2 * p4 * p6, p4 * p6 * p8) if first else (p2 * p4 * p8, p2 * p6 * p8)
            doomed = (padded[1:-1, 1:-1] == 1) & (neighbours >= 2) & (neighbours <= 6) & (transitions == 1)
            doomed &= (sides[0] == 0) & (sides[1] == 0)
            deleted += int(doomed.sum())
            padded[1:-1, 1:-1][doomed] = 0
        if deleted == 0:
            return padded[1:-1, 1:-1].astype(np.uint8)


def blobs(seed: int, height: int, width: int, level: float) -> UInt8Array:
    """Draw smooth shapes that run over the border."""
    noise = np.random.default_rng(seed).normal(size=(height + 60, width + 60)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 5)
    return (smooth[30:-30, 30:-30] > level * smooth.std()).astype(np.uint8)


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 40), st.sampled_from(WIDTHS), st.sampled_from([0, 0.1, 0.5, 0.8, 0.97, 1])
)
@settings(deadline=None, max_examples=60)
def test_equals_the_definition_on_noise(seed: int, height: int, width: int, share: float) -> None:
    image = (np.random.default_rng(seed).random((height, width)) < share).astype(np.uint8)
    np.testing.assert_array_equal(our_thin(image), plain_thin(image))


@given(st.integers(0, 2**32 - 1), st.integers(30, 130), st.sampled_from([63, 64, 65, 128, 131]))
@settings(deadline=None, max_examples=30)
def test_equals_the_definition_on_smooth_shapes(seed: int, height: int, width: int) -> None:
    image = blobs(seed, height, width, 0.0)
    np.testing.assert_array_equal(our_thin(image), plain_thin(image))

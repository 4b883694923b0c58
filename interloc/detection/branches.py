"""Segmentation of the road branches around the candidates (paper, section III-C.1)."""

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import BoolArray, FloatArray, StructuredArray
from interloc.config import BranchConfig
from interloc.detection.candidates import Candidates
from interloc.detection.centerline import Centerline, Pieces
from interloc.detection.image import BinaryImage
from interloc.detection.lines import least_squares, through_start_and_mean
from interloc.kernels.skeleton import have_surface, trace_branches

SAMPLE_PX = 4  # from one place of a branch at which its width is measured to the next
NEIGHBOUR_SHARE = 0.6  # of the distance to the next candidate, within which an inner circle stays
CORE_PX = 3.0  # from the junctions of the centerline in a candidate to its inner circle


@dataclass(frozen=True)
class Branches:
    """The branches of one candidate and the straight lines that stand for them."""

    index: int
    """Position of the candidate among all of the image."""
    candidate: FloatArray
    """(2,) float64: row and column, pixels."""
    inner: float
    """Radius of the inner circle, pixels."""
    lines: StructuredArray
    """(B,) LINE: what is known of the line of each branch, see `interloc.detection.lines.LINE`."""
    lengths: FloatArray
    """(B,) float64: pixels of centerline in each branch."""
    reaches: FloatArray
    """(B,) float64: distance from the candidate at which each branch ends, pixels."""
    core: FloatArray
    """(C, 2) float64: junction pixels of the centerline that the candidate stands for; empty for Harris corners."""
    resolution_m: float
    """Side of a pixel."""
    is_part: bool = False
    """Whether the candidate stands for one of several intersections in one blob of road."""

    @property
    def count(self) -> int:
        """Number of branches."""
        return len(self.lines)

    @property
    def has_line(self) -> BoolArray:
        """(B,) bool: whether enough of each branch could be trusted for a line."""
        return self.lines["length"] > 0.0

    def select(self, indices: list[int], candidate: FloatArray) -> "Branches":
        """Return some of the branches, around another point."""
        return replace(
            self,
            candidate=candidate,
            lines=self.lines[indices],
            lengths=self.lengths[indices],
            reaches=self.reaches[indices],
        )


@dataclass(frozen=True)
class Segmentation:
    """What became of the candidates of an image."""

    pieces: list[Pieces]
    """Around each candidate."""
    branches: list[Branches]
    """Of those that are intersections: enough branches, and far enough from the border of the image."""


def segment_all(
    candidates: Candidates,
    centerline: Centerline,
    config: BranchConfig,
    share: float = 1.0,
    against: BinaryImage | None = None,
) -> Segmentation:
    """Segment the branches of all candidates and keep the intersections among them (paper, section III-C)."""
    pieces = [trace_pieces(candidates, i, centerline, config, share) for i in range(len(candidates.positions))]
    inside = candidates.inside(centerline.image.height, config.margin_m / centerline.resolution_m).tolist()
    kept = [i for i in inside if np.count_nonzero(pieces[i].is_branch) >= config.min_branches]
    return Segmentation(pieces, [branches_of(pieces[i], candidates, i, centerline, config, against) for i in kept])


def trace_pieces(
    candidates: Candidates, index: int, centerline: Centerline, config: BranchConfig, share: float = 1.0
) -> Pieces:
    """Follow the centerline from the inner circle of a candidate outwards, and tell which pieces of it are branches.

    Parameters
    ----------
    candidates
        All of the image; a branch ends before another one.
    index
        The one looked at.
    centerline
    config
        Radii, and what is long or wide enough.
    share
        Keyframes that saw this road, as a share of a full window: fewer of them show less surface.

    Notes
    -----
    Paper, eq. 7 and 8.
    """
    resolution_m = centerline.resolution_m
    inner = inner_radius(candidates, index, resolution_m, config)
    traced, is_main, table = trace_branches(
        centerline.rows,
        centerline.cols,
        centerline.neighbours,
        candidates.positions[index],
        np.concatenate([candidates.positions[:index], candidates.positions[index + 1 :]]),
        inner,
        config.outer_radius_m / resolution_m,
        config.stop_m / resolution_m,
    )
    # A short piece is a spur; but one that another candidate cuts short is a road between two intersections.
    is_branch = table["reach"] * resolution_m >= config.min_reach_m
    if config.min_surface_m2 > 0:
        image, limit = centerline.occupancy, centerline.max_half_width
        minimum = share * config.min_surface_m2 / resolution_m**2
        graph = centerline.rows, centerline.cols, traced, table
        is_branch = have_surface(image.words, *graph, is_branch, SAMPLE_PX, image.height, limit, minimum)
    return Pieces(inner, traced, is_main, table, is_branch | table["at_candidate"])


def branches_of(
    pieces: Pieces,
    candidates: Candidates,
    index: int,
    centerline: Centerline,
    config: BranchConfig,
    against: BinaryImage | None = None,
) -> Branches:
    """Lay a line through each branch of a candidate, given all pieces around it (paper, eq. 9).

    Of `config` the kind of line counts; `against` is set where other ground was seen, None where that is not known.
    """
    position, is_branch = candidates.positions[index], pieces.is_branch
    if config.line == "start_and_mean":
        lines = through_start_and_mean(pieces)
    else:
        lines = least_squares(pieces, centerline, position, float(candidates.widths[index]), config, against)
    table = pieces.table[is_branch]
    return Branches(
        index=index,
        candidate=position,
        inner=pieces.inner,
        lines=lines[is_branch],
        lengths=(table["end"] - table["begin"]).astype(np.float64),
        reaches=table["reach"],
        core=candidates.core(index),
        resolution_m=centerline.resolution_m,
    )


def inner_radius(candidates: Candidates, index: int, resolution_m: float, config: BranchConfig) -> float:
    """Return the radius in pixels within which the centerline is bent by the junction itself."""
    radius = config.inner_radius_m / resolution_m
    if config.inner_widths is None:
        return radius
    bent = config.inner_widths * float(candidates.widths[index])
    core = candidates.core(index) - candidates.positions[index]
    if len(core):  # a junction of the centerline left outside would make one branch of two
        bent = max(bent, float(np.hypot(core[:, 0], core[:, 1]).max()) + CORE_PX)
    others = candidates.positions - candidates.positions[index]
    away = np.hypot(others[:, 0], others[:, 1])
    away[index] = np.inf
    return min(radius, bent, NEIGHBOUR_SHARE * float(away.min()))

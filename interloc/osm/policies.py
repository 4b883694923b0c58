"""The four ground truth policies in words: which nodes of OpenStreetMap count as intersections.

The denominator of recall moves by a factor of four with this choice, so every figure names its policy: of the nodes
around KITTI 00, 333 count under `all`, 119 under `drive+service`, 83 under `drive` and 79 under `consolidated`.
`interloc.osm.intersections` finds the nodes. This is the one place of the wording: report, command line, REST and page
take it from here.
"""

from typing import Literal, NamedTuple

Policy = Literal["drive", "drive+service", "all", "consolidated"]
FindingKind = Literal["missing_junction", "missing_branch", "moved", "not_joined", "no_node"]
"""Of what may be wrong in OpenStreetMap (`interloc.city.audit`)."""


class PolicyWording(NamedTuple):
    """A policy in words."""

    title: str
    """Short, for a list to choose from."""
    meaning: str
    """What counts, a whole sentence."""


POLICIES: dict[Policy, PolicyWording] = {
    "drive": PolicyWording(
        "Drivable public roads",
        "Nodes where at least three drivable public roads meet (motorway to residential) count; service roads do not. "
        "Public is meant by their class: access=private and access=no are not looked at.",
    ),
    "drive+service": PolicyWording(
        "Drivable roads and service roads",
        "Nodes where at least three drivable roads meet count; driveways, alleys and lanes of car parks are roads too.",
    ),
    "all": PolicyWording(
        "All ways",
        "Nodes where at least three ways of any kind meet count, footpaths and cycleways included, but not what is "
        "proposed, under construction or gone: many more nodes, "
        "and a much lower recall.",
    ),
    "consolidated": PolicyWording(
        "Drivable public roads, merged",
        "Nodes where at least three drivable public roads meet count, those of one place merged: a roundabout, "
        "a crossing of two carriageways, what lies around an island. Neighbours and levels stay apart.",
    ),
}

POLICY_HELP = "Which OSM nodes count as intersections. " + " ".join(
    f"{name}: {wording.meaning[0].lower()}{wording.meaning[1:]}" for name, wording in POLICIES.items()
)
TOLERANCE_HELP = "Policy consolidated merges nodes across carriageways and islands up to twice as far apart, metres."

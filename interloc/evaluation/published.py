"""The figures that the paper reports, for comparison with those of this implementation."""

from dataclasses import dataclass

SEQUENCES = ("00", "02", "05", "06", "07", "08", "09", "10")
"""SemanticKITTI sequences of the paper's tables."""

MMINSECTDET = "MMInsectDet"


@dataclass(frozen=True)
class Published:
    """Published figures of one table cell."""

    ace_m: float
    """Average center error over all matched pairs, metres."""
    precision: float
    recall: float
    """Shares, 0..1."""


PERFORMANCE: dict[str, Published] = {
    "00": Published(1.28, 0.9723, 0.9415),
    "02": Published(2.76, 0.8147, 0.7295),
    "05": Published(0.62, 1.0, 0.9187),
    "06": Published(4.21, 0.4472, 0.2590),
    "07": Published(1.25, 1.0, 0.7730),
    "08": Published(1.66, 0.9186, 0.9686),
    "09": Published(3.16, 0.7857, 0.5284),
    "10": Published(3.01, 1.0, 0.6757),
}
"""Sequence -> figures at D = 5 m, RangeNet++ labels (paper's table of the performance on SemanticKITTI)."""

AVERAGE = Published(1.92, 0.8948, 0.7674)
"""The column "Average" of that table. It is not the mean of the columns (that is 2.24 m, 85.7 %): it is pooled."""

COMPARISON: dict[str, Published] = {
    MMINSECTDET: Published(4.25, 0.8923, 0.8310),
    "InterLoc, published": Published(1.92, 0.9438, 0.8428),
}
"""Method -> ACE, precision at 6.9 m, recall at 13.3 m (paper's comparison)."""

LABEL_ERRORS: dict[str, Published] = {
    "0/0": Published(1.86, 0.9006, 0.8069),
    "5/5": Published(2.26, 0.9059, 0.7614),
    "5/20": Published(2.32, 0.9059, 0.7644),
    "20/5": Published(2.94, 0.8095, 0.6839),
    "20/20": Published(3.23, 0.7883, 0.6800),
}
"""r-FPR / r-FNR in percent -> figures at D = 5 m, hand labels, all eight sequences (paper's table of label errors)."""

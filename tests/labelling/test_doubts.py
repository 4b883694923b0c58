"""Doubts about labels by geometry."""

from __future__ import annotations

from interloc.labelling.track import WindowQuality, doubts_in_words, joined


def test_little_contrast_a_wide_road_and_a_patched_strip_are_doubtful() -> None:
    assert not WindowQuality(0.0, 25.0, contrast=9.0, width_m=7.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=3.0, width_m=7.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=9.0, width_m=12.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=9.0, width_m=7.0, evenness=0.5).is_doubtful


def test_stretches_that_follow_each_other_are_one() -> None:
    assert joined([(25.0, 50.0), (100.0, 125.0), (125.0, 150.0)]) == [(25.0, 50.0), (100.0, 150.0)]
    assert "doubtful from 310 to 450 m, 1,000 to 1,025 m of the track" in doubts_in_words([(310, 450), (1000, 1025)])

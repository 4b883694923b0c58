"""Numbers as a person reads them."""


def counted(count: int, noun: str) -> str:
    """Return a number and what it counts: "1 keyframe", "1,250 keyframes"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def percent(value: float | None) -> str:
    """Return a ratio: "94.2 %", or a dash where it is undefined."""
    return "–" if value is None else f"{100.0 * value:.1f} %"  # noqa: RUF001 - a dash, not a minus


def metres(value: float | None) -> str:
    """Return a distance: "1.28 m", or a dash where it is undefined."""
    return "–" if value is None else f"{value:.2f} m"  # noqa: RUF001

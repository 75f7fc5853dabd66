"""What the hover of a flight says of a twin, in a sentence."""

from twin.residuals.means import HoverMeans

LEAST_M = 5e-4
"""A centre of mass that is off by less is not said."""


def hover_sentence(vehicle: str, means: HoverMeans) -> str:
    """The weight that a twin carries at the logged commands, and where it seems to hang."""
    text = f"At the logged commands {vehicle} carries {100 * means.carried:.0f} % of its weight"
    off = [
        f"{1e3 * abs(value):.1f} mm further {forth if value > 0 else back}"
        for value, forth, back in (
            (means.back_m, "back", "forward"),
            (means.right_m, "to the right", "to the left"),
        )
        if value is not None and abs(value) >= LEAST_M
    ]
    if off:
        text += f", and turns as if the centre of mass were {' and '.join(off)}"
    return f"{text}."

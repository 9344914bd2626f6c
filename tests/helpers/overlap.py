"""Parts of a figure that lie over each other."""

from __future__ import annotations

from itertools import combinations

from matplotlib.figure import Figure


def overlaps(figure: Figure) -> list[tuple[str, str]]:
    """Returns the titles of each two axes that overlap, with all that belongs to them: legends, labels and titles."""
    figure.draw_without_rendering()
    boxes = [(axes.get_title(), axes.get_tightbbox()) for axes in figure.axes if axes.axison]
    within = [(title, box.shrunk(0.995, 0.995)) for title, box in boxes if box is not None]
    return [(one, other) for (one, box), (other, second) in combinations(within, 2) if box.overlaps(second)]

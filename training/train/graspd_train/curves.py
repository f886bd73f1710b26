"""Learning curves as a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

PANELS = [
    ("losses, training", ["loss", "contact", "orientation", "centroid"]),
    ("Supplementary Note 2, validation", ["e_pc", "e_pe", "e_angle"]),
    ("at labels, validation", ["e_pc_labelled", "e_pe_labelled", "focal_c", "focal_e"]),
]


def draw(rows: list[dict], path: Path) -> None:
    """Draws the rows of `curves.csv`, over views seen."""
    figure, axes = plt.subplots(1, len(PANELS), figsize=(14, 4), constrained_layout=True)
    for axis, (title, names) in zip(axes, PANELS, strict=True):
        for name in names:
            points = [(row["samples"], row[name]) for row in rows if name in row]
            if points:
                axis.plot(*zip(*points, strict=True), marker="." if len(points) < 20 else "", label=name)
        axis.set_title(title)
        axis.set_xlabel("views seen")
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)

"""How good a contact field is: E_Pc, E_Pe and E_Angle of Supplementary Note 2, and where its strongest answers lie.

Scores are probabilities of one event per voxel, so the divergence of a voxel is that of two Bernoulli distributions.
E_Pc and E_Pe are exp(-KL) averaged over all voxels; since nearly all voxels are empty these sit close to 1, and
`*_labelled` averages over labelled voxels alone. E_Angle is the cosine between labelled and predicted inward
directions, weighted by the label's score.
"""

from __future__ import annotations

from collections import defaultdict

import torch
import torch.nn.functional as F
from torch import Tensor

from . import rotation
from .losses import Batch

# Voxels above this share of a view's greatest certainty, or centroid score, are focal (Supplementary Note 3).
FOCAL_CONTACT, FOCAL_CENTROID = 0.7, 0.9


def likeness(p: Tensor, q: Tensor) -> Tensor:
    """exp(-KL(p‖q)) of Bernoulli distributions, element by element; 1 where both say the same."""
    eps = 1e-7
    q = q.clamp(eps, 1 - eps)
    divergence = torch.special.xlogy(p, p / q) + torch.special.xlogy(1 - p, (1 - p) / (1 - q))
    return torch.exp(-divergence.clamp_min(0))


def hit_rate(score: Tensor, label: Tensor, share: float) -> float:
    """Which part of the focal voxels of one view [n, n, n] lies on a label or beside one."""
    focal = score > share * score.max()
    near = F.max_pool3d((label > 0).float()[None, None], 3, 1, 1)[0, 0] > 0
    return (focal & near).sum().item() / max(focal.sum().item(), 1)


class Metrics:
    """Means over the views that were added."""

    def __init__(self) -> None:
        self.sums: dict[str, float] = defaultdict(float)
        self.counts: dict[str, float] = defaultdict(float)

    def put(self, name: str, value: float, weight: float = 1.0) -> None:
        self.sums[name] += value * weight
        self.counts[name] += weight

    def add(self, answer: Tensor, batch: Batch) -> None:
        """Adds a batch of views with all their labels."""
        views, _, side = answer.shape[:3]
        voxels = side**3
        scores = answer[:, :2].float().sigmoid()
        for name, focal, index, target, channel in (
            ("c", FOCAL_CONTACT, batch.contact_index, batch.contact_score, 0),
            ("e", FOCAL_CENTROID, batch.centroid_index, batch.centroid_score, 1),
        ):
            found = scores[:, channel]
            label = torch.zeros(views * voxels, device=answer.device)
            label[index] = target
            label = label.reshape(found.shape)
            alike = likeness(label, found)
            for view in range(views):
                self.put(f"e_p{name}", alike[view].mean().item())
                named = label[view] > 0
                if named.any():
                    self.put(f"e_p{name}_labelled", alike[view][named].mean().item())
                    self.put(f"focal_{name}", hit_rate(found[view], label[view], focal))
        flat = answer.reshape(views, -1, voxels)
        at = batch.oriented_index
        if len(at):
            found = rotation.inward(flat[at // voxels, 2:, at % voxels].float())
            cosine = (found * rotation.matrix(batch.orientation)[..., 2]).sum(1)
            weight = batch.orientation_weight
            self.put("e_angle", ((cosine * weight).sum() / weight.sum()).item(), weight.sum().item())

    def means(self) -> dict[str, float]:
        """The mean of each metric."""
        return {name: self.sums[name] / self.counts[name] for name in sorted(self.sums)}

"""Losses: binary cross-entropy of both scores, and how far orientations are off, weighted by the label's score.

The plain sum of three means, as the reference trains.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from . import rotation
from .sampling import Targets


@dataclass(frozen=True)
class Batch:
    """Targets of a batch, flat: `*_index` counts voxels through the whole batch, view after view."""

    contact_index: Tensor
    contact_score: Tensor
    # Of the labelled contacts alone, with their places and weights.
    oriented_index: Tensor
    orientation: Tensor
    orientation_weight: Tensor
    centroid_index: Tensor
    centroid_score: Tensor

    @staticmethod
    def of(targets: list[Targets], voxels: int, device: torch.device | str = "cpu") -> Batch:
        """One batch of the targets of its views."""

        def join(parts: list, kind: torch.dtype) -> Tensor:
            return torch.cat([torch.as_tensor(p) for p in parts]).to(device=device, dtype=kind)

        shifted = [(k * voxels, t, len(t.orientation)) for k, t in enumerate(targets)]
        return Batch(
            contact_index=join([t.contact_index + s for s, t, _ in shifted], torch.int64),
            contact_score=join([t.contact_score for t in targets], torch.float32),
            oriented_index=join([t.contact_index[:m] + s for s, t, m in shifted], torch.int64),
            orientation=join([t.orientation for t in targets], torch.float32).reshape(-1, 4),
            orientation_weight=join([t.contact_score[:m] for _, t, m in shifted], torch.float32),
            centroid_index=join([t.centroid_index + s for s, t, _ in shifted], torch.int64),
            centroid_score=join([t.centroid_score for t in targets], torch.float32),
        )


def orientation_loss(answer: Tensor, index: Tensor, q: Tensor, weight: Tensor) -> Tensor:
    """1 - |q·q̂| of quaternions, mean absolute difference of the six numbers of R6D; weighted mean over labels."""
    batch, channels = answer.shape[:2]
    voxels = answer[0, 0].numel()
    flat = answer.reshape(batch, channels, voxels)
    found = flat[index // voxels, 2:, index % voxels].float()
    if found.shape[1] == 4:
        away = 1 - (rotation.normalized(found) * q).sum(1).abs()
    else:
        away = (found - rotation.r6d(q)).abs().mean(1)
    return (away * weight).sum() / max(len(weight), 1)


def sparse_losses(answer: Tensor, batch: Batch) -> dict[str, Tensor]:
    """Losses at the sampled voxels alone. `answer` [batch, channels, n, n, n] as models.py describes it."""
    scores = answer[:, :2].float()
    certainty, centroid = scores[:, 0].reshape(-1), scores[:, 1].reshape(-1)

    def score(logits: Tensor, index: Tensor, target: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(logits[index], target) if len(index) else logits.sum() * 0

    return {
        "contact": score(certainty, batch.contact_index, batch.contact_score),
        "orientation": orientation_loss(answer, batch.oriented_index, batch.orientation, batch.orientation_weight),
        "centroid": score(centroid, batch.centroid_index, batch.centroid_score),
    }


def dense_losses(answer: Tensor, batch: Batch, negative_weight: float) -> dict[str, Tensor]:
    """Losses at every voxel: labelled ones count 1, all others `negative_weight`.

    Sums are divided by the number of labels (at least a thousandth of the voxels, so that a view without labels cannot
    drown the others), so that the balance of positives and negatives does not move with how full a scene is.
    """
    scores = answer[:, :2].float()

    def score(logits: Tensor, index: Tensor, target: Tensor) -> Tensor:
        logits = logits.reshape(-1)
        # Cross-entropy with target 0 everywhere, then the difference at labelled voxels.
        background = F.softplus(logits).sum() - F.softplus(logits[index]).sum()
        labelled = F.binary_cross_entropy_with_logits(logits[index], target, reduction="sum")
        labels = max(len(index), logits.numel() / 1000)
        return (labelled + negative_weight * background) / labels

    return {
        "contact": score(scores[:, 0], batch.contact_index, batch.contact_score),
        "orientation": orientation_loss(answer, batch.oriented_index, batch.orientation, batch.orientation_weight),
        "centroid": score(scores[:, 1], batch.centroid_index, batch.centroid_score),
    }

"""Which voxels of a view are learned from, and what they should answer.

`sparse` is Supplementary Note 1: N_tc contact samples, a share a_c of them without contact, and N_tc / 4 centroid
samples, a share a_e of them without centroid. `dense` takes every voxel: labelled ones fully, the others with a small
weight, since whoever only sees one voxel in a hundred of the empty ones learns them slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .sample import Sample


@dataclass(frozen=True)
class Recipe:
    """Numbers of the sampling; defaults are the paper's (Supplementary Note 1)."""

    # N_tc: contact samples of a view.
    contacts: int = 3000
    # a_c: share of them without contact; of these a share lies in occupied voxels.
    non_contacts: float = 0.20
    in_occupied: float = 0.25
    # N_tc = 4 · N_te.
    centroids: int = 750
    # a_e: share of centroid samples without centroid.
    non_centroids: float = 0.40


@dataclass(frozen=True)
class Targets:
    """What a view should answer: at flat voxel indices, scores, with a weight each.

    The first `len(orientation)` contacts are labelled and have an orientation.
    """

    contact_index: np.ndarray
    contact_score: np.ndarray
    orientation: np.ndarray
    centroid_index: np.ndarray
    centroid_score: np.ndarray


def pick(rng: np.random.Generator, count: int, number: int) -> np.ndarray:
    """`number` of `count` things, each at most once if there are enough; none of none."""
    if count == 0:
        return np.empty(0, dtype=np.int64)
    return rng.choice(count, number, replace=count < number)


def empty_voxels(rng: np.random.Generator, allowed: np.ndarray, number: int) -> np.ndarray:
    """Indices of `number` random voxels of a mask."""
    places = np.flatnonzero(allowed)
    return places[pick(rng, len(places), number)]


def sparse(sample: Sample, kind: str, rng: np.random.Generator, recipe: Recipe = Recipe()) -> Targets:
    """Random samples with labels and without, as the paper draws them.

    A voxel without contact has score 0 and the identity as its orientation; that orientation has weight 0 in the loss,
    so it is not kept here.
    """
    without = round(recipe.contacts * recipe.non_contacts)
    in_occupied = round(without * recipe.in_occupied)
    chosen = pick(rng, len(sample.contact_index), recipe.contacts - without)
    free_of_contact = np.ones(sample.side**3, dtype=bool)
    free_of_contact[sample.contact_index] = False
    occupied = sample.occupied(kind)
    negatives = np.concatenate([
        empty_voxels(rng, free_of_contact & occupied, in_occupied),
        empty_voxels(rng, free_of_contact & ~occupied, without - in_occupied),
    ])

    no_centroids = round(recipe.centroids * recipe.non_centroids)
    centroids = pick(rng, len(sample.centroid_index), recipe.centroids - no_centroids)
    free_of_centroid = np.ones(sample.side**3, dtype=bool)
    free_of_centroid[sample.centroid_index] = False
    elsewhere = empty_voxels(rng, free_of_centroid, no_centroids)
    return Targets(
        contact_index=np.concatenate([sample.contact_index[chosen], negatives]),
        contact_score=np.concatenate([sample.contact_score[chosen], np.zeros(len(negatives), np.float32)]),
        orientation=sample.contact_orientation[chosen],
        centroid_index=np.concatenate([sample.centroid_index[centroids], elsewhere]),
        centroid_score=np.concatenate([sample.centroid_score[centroids], np.zeros(len(elsewhere), np.float32)]),
    )


def dense(sample: Sample) -> Targets:
    """All labels; whoever takes them counts every other voxel as a weak negative."""
    return Targets(
        contact_index=sample.contact_index,
        contact_score=sample.contact_score,
        orientation=sample.contact_orientation,
        centroid_index=sample.centroid_index,
        centroid_score=sample.centroid_score,
    )

"""Views of a folder of shards: which there are, in which order an epoch takes them, and reading ahead.

Everything random depends on seed, epoch and place alone, so that an interrupted training goes on as if it had not been.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from . import sampling, shards
from .augment import SYMMETRIES, transform
from .losses import Batch
from .sample import Sample

# Of the scenes of a folder every twentieth is kept for validation when no other folder is named for it.
HELD_OUT_EVERY = 20


@dataclass(frozen=True)
class View:
    """Where a view lies."""

    shard: shards.Shard
    record: int
    scene: int


def scene_of(header: dict, record: int) -> int:
    """The scene of a record: record k is view k mod V of scene i + n·(k div V)."""
    shard, count = header["shard"]
    return shard + count * (record // header["views"])


def of_record(record: shards.Sample, kind: str) -> Sample:
    """A record of a shard as the network of that kind of volume sees it."""
    index, score, orientation = record.contacts(kind)
    return Sample(record.volume(kind), index, score, orientation, record.centroid_index, record.centroid_score)


class Views:
    """All views of a folder. Shards are looked at again by `refresh`: data may still be growing."""

    def __init__(self, folder: Path, held_out: bool | None = None):
        """`held_out`: only scenes kept for validation (true), only the others (false), or all."""
        self.folder, self.held_out = Path(folder), held_out
        self.refresh()

    def refresh(self) -> None:
        """Looks for new shards and new records."""
        opened = [shards.Shard(path) for path in sorted(self.folder.glob("*.gcd"))]
        if not opened:
            raise FileNotFoundError(f"{self.folder}: found no *.gcd, expected shards of `graspd dataset generate`")
        self.headers = {shard.path.name: shard.header for shard in opened}
        everything = [View(s, record, scene_of(s.header, record)) for s in opened for record in range(len(s))]
        self.views = [v for v in everything if self.held_out in (None, v.scene % HELD_OUT_EVERY == HELD_OUT_EVERY - 1)]
        if not self.views:
            raise ValueError(f"{self.folder}: found {len(everything)} views, none of them of the wanted scenes")

    def describe(self) -> dict:
        """What a model card says of the data: how much, and the headers but for what differs between shards."""
        scenes = {view.scene for view in self.views}
        header = dict(next(iter(self.headers.values())))
        header.pop("shard", None)
        return {"views": len(self.views), "scenes": len(scenes), "shards": len(self.headers), "header": header}

    def __len__(self) -> int:
        return len(self.views)

    def read(self, view: View, kind: str) -> Sample:
        """The view as the network of that volume kind sees it."""
        return of_record(view.shard[view.record], kind)


def order(views: int, seed: int, epoch: int, wanted: int | None) -> np.ndarray:
    """Which views an epoch takes, and in which order."""
    return np.random.default_rng([seed, epoch]).permutation(views)[:wanted]


def drawn(views: Views, run, epoch: int, place: int, number: int) -> tuple[Sample, sampling.Targets]:
    """View `number`, turned and sampled as chance has it at this place of this epoch."""
    rng = np.random.default_rng([run.seed, epoch, place])
    sample = views.read(views.views[number], run.volume)
    if run.augment:
        sample = transform(sample, int(rng.integers(SYMMETRIES)))
    return sample, sampling.dense(sample) if run.dense else sampling.sparse(sample, run.volume, rng)


def batches(
    views: Views, run, epoch: int | None, device: torch.device | str = "cpu", start: int = 0
) -> Iterator[tuple[Tensor, Batch, int]]:
    """Volumes [b, 1, n, n, n], their targets, and b: of a training epoch from its place `start` on.

    Without an epoch: of at most `run.validation_views` views spread over the folder, untouched, with all labels.
    """
    if epoch is None:
        count = min(run.validation_views, len(views))
        numbers = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))

        def make(place: int) -> tuple[Sample, sampling.Targets]:
            sample = views.read(views.views[numbers[place]], run.volume)
            return sample, sampling.dense(sample)
    else:
        numbers = order(len(views), run.seed, epoch, run.views_per_epoch)

        def make(place: int) -> tuple[Sample, sampling.Targets]:
            return drawn(views, run, epoch, place, int(numbers[place]))

    def batch(first: int) -> tuple[Tensor, Batch, int]:
        made = [make(place) for place in range(first, min(first + run.batch, len(numbers)))]
        volumes = torch.from_numpy(np.stack([sample.volume for sample, _ in made])[:, None])
        targets = Batch.of([t for _, t in made], volumes[0].numel(), device)
        return volumes, targets, len(made)

    yield from ahead(batch, range(start, len(numbers), run.batch))


def ahead(make: Callable, places: range, depth: int = 3) -> Iterator:
    """`make` of each place, in order, made by a thread that is up to `depth` ahead of whoever reads."""
    made: queue.Queue = queue.Queue(depth)
    stop = threading.Event()

    def put(thing) -> bool:
        while not stop.is_set():
            try:
                made.put(thing, timeout=0.2)
                return True
            except queue.Full:
                continue
        return False

    def work() -> None:
        try:
            for place in places:
                if not put((make(place), None)):
                    return
            put((None, None))
        except BaseException as error:  # noqa: BLE001: handed over to the reader.
            put((None, error))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        while True:
            thing, error = made.get()
            if error is not None:
                raise error
            if thing is None:
                return
            yield thing
    finally:
        stop.set()
        thread.join()

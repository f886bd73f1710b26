"""Reading shards of the contact dataset (docs/dataset.md): numpy and the standard library, nothing else.

>>> data = Dataset("data/train")                    # every shard of a folder; Shard(path) for one file
>>> sample = data[0]
>>> sample.tsdf.shape, sample.contact_quaternion.shape
((80, 80, 80), (2513, 4))
"""

from __future__ import annotations

import bisect
import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Iterator

import numpy as np

MAGIC = b"GCDS"
VERSION = 1
FORMAT = "graspd contact dataset"
MAX_HEADER = 16 << 20
MAX_PACKED = 64 << 20
MIN_RESOLUTION, MAX_RESOLUTION = 8, 160
# TSDF codes that mean an occupied voxel: above 0 (unseen), up to 0.5 (the surface).
OCCUPIED = (1, 127)


class ShardError(ValueError):
    """Bytes that are no shard of this version, or damaged: the part, what was found, what was expected."""

    def __init__(self, part: str, found: object, expected: object) -> None:
        super().__init__(f"{part}: found {found}, expected {expected}")


@dataclass(frozen=True)
class Sample:
    """One labelled view. Arrays are indexed [x, y, z] in the volume frame; contacts have one row each."""

    scene: int
    view: int
    world_from_volume: np.ndarray
    """(4, 4) float32."""
    world_from_camera: np.ndarray
    """(4, 4) float32, optical frame."""
    table_m: float
    """Height of the table top in the volume, metres; NaN for none."""
    tsdf: np.ndarray
    """(n, n, n) uint8: the network's input times 255."""
    occupancy: np.ndarray
    """(n, n, n) bool: True unless seen to be free."""
    contact_index: np.ndarray
    """(C,) int64, ascending: memory index (x·n + y)·n + z."""
    contact_score: np.ndarray
    """(C,) float32, above 0 to 1."""
    contact_quaternion: np.ndarray
    """(C, 4) float32, unit, x y z w with w ≥ 0: the image of +z points from the finger into the object."""
    centroid_index: np.ndarray
    """(E,) int64, ascending."""
    centroid_score: np.ndarray
    """(E,) float32, above 0 to 1."""
    preview_mm: np.ndarray
    """(h, w) uint16: the depth image, small, for people."""

    @property
    def resolution(self) -> int:
        """Voxels along each edge."""
        return self.tsdf.shape[0]

    def volume(self, kind: str) -> np.ndarray:
        """What a network reads, float32 (n, n, n), 0 to 1: `kind` is "tsdf" or "occupancy"."""
        if kind == "tsdf":
            return self.tsdf.astype(np.float32) / np.float32(255)
        if kind == "occupancy":
            return self.occupancy.astype(np.float32)
        raise ValueError(f"kind: found {kind!r}, expected 'tsdf' or 'occupancy'")

    def contacts(self, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Index, score and quaternion of the contacts that this kind of volume leaves: an occupancy volume counts the
        unseen as occupied, and no contact is in an occupied voxel."""
        if kind == "tsdf":
            return self.contact_index, self.contact_score, self.contact_quaternion
        if kind == "occupancy":
            free = ~self.occupancy.reshape(-1)[self.contact_index]
            return self.contact_index[free], self.contact_score[free], self.contact_quaternion[free]
        raise ValueError(f"kind: found {kind!r}, expected 'tsdf' or 'occupancy'")


class _Rest:
    """What is left to read of a payload."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def array(self, field: str, dtype: str, count: int) -> np.ndarray:
        size = np.dtype(dtype).itemsize * count
        left = len(self.data) - self.at
        if size > left:
            raise ShardError(field, f"{left} bytes", f"{size} bytes")
        out = np.frombuffer(self.data, dtype, count, self.at)
        self.at += size
        return out

    def number(self, field: str, dtype: str) -> int:
        return int(self.array(field, dtype, 1)[0])

    def labels(self, field: str, voxels: int) -> tuple[np.ndarray, np.ndarray]:
        count = self.number(field, "<u4")
        if count > voxels:
            raise ShardError(f"{field}.index", f"{count} labels", f"at most {voxels}")
        index = self.array(f"{field}.index", "<u4", count).astype(np.int64)
        if count and (np.any(np.diff(index) <= 0) or index[-1] >= voxels):
            raise ShardError(f"{field}.index", "indices out of order or range", f"ascending, below {voxels}")
        score = self.array(f"{field}.score", "u1", count)
        if np.any(score == 0):
            raise ShardError(f"{field}.score", 0, "1 to 255")
        return index, score


def parse(payload: bytes) -> Sample:
    """A sample from its unpacked payload.

    Raises ShardError for the first field that is cut off, out of range or not in order, and for bytes left over.
    """
    rest = _Rest(payload)
    scene, view, n = (rest.number(field, "<u4") for field in ("scene", "view", "resolution"))
    if not MIN_RESOLUTION <= n <= MAX_RESOLUTION:
        raise ShardError("resolution", n, f"{MIN_RESOLUTION} to {MAX_RESOLUTION}")
    poses = [rest.array(f"world_from_{name}", "<f4", 16).reshape(4, 4).copy() for name in ("volume", "camera")]
    for name, pose in zip(("volume", "camera"), poses):
        if not np.all(np.isfinite(pose)):
            raise ShardError(f"world_from_{name}", pose.tolist(), "finite numbers")
    table_m = float(rest.array("table_m", "<f4", 1)[0])
    voxels = n**3
    tsdf = rest.array("tsdf", "u1", voxels).reshape(n, n, n)
    bits = rest.array("occupancy", "u1", -(-voxels // 8))
    occupancy = np.unpackbits(bits, bitorder="little")[:voxels].view(bool).reshape(n, n, n)
    index, score = rest.labels("contacts", voxels)
    quaternion = rest.array("contacts.orientation", "<i2", 4 * len(index)).reshape(-1, 4).astype(np.float32)
    quaternion /= np.float32(32767)
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    if np.any((length < 0.99) | (length > 1.01)):
        raise ShardError("contacts.orientation", "other lengths", "quaternions of length 32767")
    quaternion = quaternion / length
    centroid_index, centroid_score = rest.labels("centroids", voxels)
    width, height = rest.number("preview.width", "<u2"), rest.number("preview.height", "<u2")
    preview = rest.array("preview.depth", "<u2", width * height).reshape(height, width)
    if rest.at != len(payload):
        raise ShardError("payload", f"{len(payload) - rest.at} bytes behind its end", "none")
    return Sample(
        scene=scene,
        view=view,
        world_from_volume=poses[0],
        world_from_camera=poses[1],
        table_m=table_m,
        tsdf=tsdf,
        occupancy=occupancy,
        contact_index=index,
        contact_score=score.astype(np.float32) / np.float32(255),
        contact_quaternion=quaternion,
        centroid_index=centroid_index,
        centroid_score=centroid_score.astype(np.float32) / np.float32(255),
        preview_mm=preview,
    )


class Shard:
    """One file. It is opened anew for every read, so that a shard may be handed to other processes."""

    def __init__(self, path: str | Path) -> None:
        """Reads the header and finds the records; a last record that is cut off is left out."""
        self.path = Path(path)
        length = self.path.stat().st_size
        with self.path.open("rb") as file:
            self.header, end = _read_header(file, length)
            self._records: list[tuple[int, int]] = []
            while end + 8 <= length:
                file.seek(end)
                (packed,) = struct.unpack("<I", file.read(4))
                if end + 8 + packed > length or packed > MAX_PACKED:
                    break
                self._records.append((end, packed))
                end += 8 + packed
        self.left_over = length - end

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, record: int) -> Sample:
        """The sample of a record. Raises ShardError for one that is damaged, IndexError for one that is not there."""
        if not 0 <= record < len(self):
            raise IndexError(f"record {record} of {len(self)}")
        start, length = self._records[record]
        with self.path.open("rb") as file:
            file.seek(start + 4)
            (expected,) = struct.unpack("<I", file.read(4))
            packed = file.read(length)
        found = zlib.crc32(packed)
        if found != expected:
            raise ShardError(f"{self.path}: record {record}: CRC-32", f"{found:08x}", f"{expected:08x}")
        try:
            sample = parse(zlib.decompress(packed))
        except zlib.error as error:
            raise ShardError(f"{self.path}: record {record}: payload", error, "a zlib stream") from error
        if sample.resolution != self.header["grid"]["resolution"]:
            raise ShardError(f"record {record}: resolution", sample.resolution, self.header["grid"]["resolution"])
        return sample

    def __iter__(self) -> Iterator[Sample]:
        return (self[record] for record in range(len(self)))


def _read_header(file: BinaryIO, length: int) -> tuple[dict, int]:
    prefix = file.read(16)
    if len(prefix) < 16:
        raise ShardError("shard", f"{length} bytes", "at least 16")
    if prefix[:4] != MAGIC:
        raise ShardError("magic", prefix[:4], MAGIC)
    version, size, expected = struct.unpack("<III", prefix[4:])
    if version != VERSION:
        raise ShardError("version", version, VERSION)
    if size > MAX_HEADER or 16 + size > length:
        raise ShardError("header.length", size, f"at most {min(MAX_HEADER, length - 16)}")
    text = file.read(size)
    found = zlib.crc32(text)
    if found != expected:
        raise ShardError("header: CRC-32", f"{found:08x}", f"{expected:08x}")
    try:
        header = json.loads(text)
    except ValueError as error:
        raise ShardError("header", error, "JSON") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ShardError("header.format", header if not isinstance(header, dict) else header.get("format"), FORMAT)
    resolution = header.get("grid", {}).get("resolution")
    if not isinstance(resolution, int) or not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        raise ShardError("header.grid.resolution", resolution, f"{MIN_RESOLUTION} to {MAX_RESOLUTION}")
    return header, 16 + size


class Dataset:
    """All shards of a folder, in the order of their names, as one list of samples."""

    def __init__(self, folder: str | Path) -> None:
        """Opens every *.gcd of a folder. Raises ShardError when there is none."""
        self.shards = [Shard(path) for path in sorted(Path(folder).glob("*.gcd"))]
        if not self.shards:
            raise ShardError(str(folder), "no shard", "files ending in .gcd")
        self._starts = [0]
        for shard in self.shards:
            self._starts.append(self._starts[-1] + len(shard))

    def __len__(self) -> int:
        return self._starts[-1]

    def __getitem__(self, index: int) -> Sample:
        """Sample number `index`, counted through all shards."""
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        shard = bisect.bisect_right(self._starts, index) - 1
        return self.shards[shard][index - self._starts[shard]]

"""Trains a network: `python -m graspd_train.train --data DIR --volume tsdf --orientation quaternion --out RUN`.

A run is a folder: `checkpoint.pt` (everything to go on from), `curves.csv`, `curves.png`, `run.json`. The same command
again goes on where the last one stopped, in the middle of an epoch too, and on one machine comes to the same weights
as a run that was never interrupted, as long as the data did not grow.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import platform
import subprocess
import sys
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import torch
from torch import nn

from . import __version__, losses
from .curves import draw
from .data import Views, batches
from .metrics import Metrics
from .models import ORIENTATION_NUMBERS, build


@dataclass(frozen=True)
class Run:
    """What decides a run's result, and is kept in its checkpoint. Defaults are the paper's recipe (Note 1)."""

    data: str
    validation: str | None = None
    volume: str = "tsdf"
    orientation: str = "quaternion"
    model: str = "ours"
    widths: tuple[int, ...] | None = None
    dense: bool = False
    negative_weight: float = 0.1
    epochs: int = 64
    views_per_epoch: int | None = None
    batch: int = 4
    rate: float = 1e-3
    schedule: str = "halving"
    halve_every: int = 20
    augment: bool = True
    precision: str = "f32"
    averaging: float = 0.999
    seed: int = 1
    validation_views: int = 64
    start: str | None = None


def learning_rate(run: Run, step: int, steps_per_epoch: int) -> float:
    """The rate of a step: halved every so many epochs, or one cosine to 0 after a short rise."""
    if run.schedule == "halving":
        return run.rate * 0.5 ** (step // steps_per_epoch // run.halve_every)
    steps = run.epochs * steps_per_epoch
    rise = max(1, min(500, steps // 20))
    if step < rise:
        return run.rate * (step + 1) / rise
    return run.rate * 0.5 * (1 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))


class Averaged:
    """A moving average of weights and batch norm statistics: steadier than the last iterate, and what is exported."""

    def __init__(self, net: nn.Module, decay: float):
        self.decay = decay
        self.state = {name: value.detach().clone() for name, value in net.state_dict().items()}

    @torch.no_grad()
    def update(self, net: nn.Module, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        for name, value in net.state_dict().items():
            if value.dtype.is_floating_point:
                self.state[name].lerp_(value, 1 - decay)
            else:
                self.state[name].copy_(value)


def forward(net: nn.Module, volume: torch.Tensor, run: Run, device: torch.device) -> torch.Tensor:
    """The network's answer, in bf16 where the run says so."""
    casting = torch.autocast(device.type, dtype=torch.bfloat16) if run.precision == "bf16" else nullcontext()
    with casting:
        return net(volume.to(device, non_blocking=True).contiguous(memory_format=torch.channels_last_3d))


def validate(state: dict, run: Run, settings: dict, views: Views, device: torch.device) -> dict[str, float]:
    """Metrics of weights over validation views, which are spread evenly over the folder."""
    net = build(run.model, run.orientation, **settings).to(device, memory_format=torch.channels_last_3d)
    net.load_state_dict(state)
    net.eval()
    metrics = Metrics()
    with torch.no_grad():
        for volume, batch, _ in batches(views, run, epoch=None, device=device):
            metrics.add(forward(net, volume, run, device), batch)
    return metrics.means()


def commit() -> str:
    """The commit that the program is at, with a plus if files have changed."""
    here = Path(__file__).parent
    try:
        found = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True)
        dirty = subprocess.run(["git", "status", "--porcelain", "."], cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.stdout.strip() + ("+" if dirty.stdout.strip() else "")


def save(path: Path, checkpoint: dict) -> None:
    """Writes a checkpoint so that there is always a whole one."""
    part = path.with_suffix(".part")
    torch.save(checkpoint, part)
    os.replace(part, path)


class Training:
    """One run: made new or from its checkpoint, and trained on until it ends or time is up."""

    def __init__(self, run: Run, out: Path, command: str, device: torch.device):
        self.run, self.out, self.command, self.device = run, out, command, device
        torch.manual_seed(run.seed)
        if run.validation:
            self.train_views, self.validation_views = Views(Path(run.data)), Views(Path(run.validation))
        else:
            self.train_views = Views(Path(run.data), held_out=False)
            self.validation_views = Views(Path(run.data), held_out=True)
        settings = {"widths": tuple(run.widths)} if run.widths else {}
        self.net = build(run.model, run.orientation, **settings)
        self.settings = self.net.settings
        self.net.to(device, memory_format=torch.channels_last_3d)
        self.optimizer = torch.optim.Adam(self.net.parameters(), lr=run.rate)
        self.averaged = Averaged(self.net, run.averaging)
        # `place`: views of this epoch that are behind us.
        self.epoch = self.place = self.step = self.samples_seen = 0
        self.seconds = 0.0
        self.totals: dict[str, float] = {}
        self.rows: list[dict] = []
        self.validation: dict[str, float] | None = None
        self.origin: dict | None = None
        out.mkdir(parents=True, exist_ok=True)
        self.path = out / "checkpoint.pt"
        if self.path.exists():
            self.resume()
        elif run.start:
            self.begin_from(Path(run.start))

    def begin_from(self, path: Path) -> None:
        """Takes the averaged weights of another run's checkpoint; the optimizer begins anew."""
        other = torch.load(path, map_location=self.device, weights_only=True)
        theirs, ours = other["run"], asdict(self.run)
        wrong = [f"{k}: found {theirs[k]!r}, expected {ours[k]!r}" for k in ("model", "volume", "orientation", "widths") if theirs[k] != _plain(ours[k])]
        if wrong:
            raise SystemExit(f"--from {path}: weights of another network ({'; '.join(wrong)})")
        self.net.load_state_dict(other["averaged"])
        self.averaged.state = {name: value.clone() for name, value in other["averaged"].items()}
        known = ("command", "commit", "epoch", "place", "samples_seen", "data", "origin")
        self.origin = {name: other[name] for name in known if name in other}

    def resume(self) -> None:
        """Goes on from the checkpoint, which must be of the same run."""
        kept = torch.load(self.path, map_location=self.device, weights_only=True)
        before, now = kept["run"], asdict(self.run)
        other = [f"{k}: found {before.get(k)!r}, expected {now[k]!r}" for k in now if _plain(before.get(k)) != _plain(now[k])]
        if other:
            raise SystemExit(f"{self.path}: this checkpoint is of another run ({'; '.join(other)}); name another --out")
        self.net.load_state_dict(kept["weights"])
        self.averaged.state = kept["averaged"]
        self.optimizer.load_state_dict(kept["optimizer"])
        for name in ("epoch", "place", "step", "samples_seen", "seconds", "totals", "rows", "validation"):
            setattr(self, name, kept[name])
        self.origin = kept.get("origin")

    def keep(self) -> None:
        """Writes the checkpoint."""
        save(self.path, {
            "run": {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self.run).items()},
            "settings": self.settings,
            "weights": self.net.state_dict(),
            "averaged": self.averaged.state,
            "optimizer": self.optimizer.state_dict(),
            **{name: getattr(self, name) for name in ("epoch", "place", "step", "samples_seen", "seconds", "totals", "rows", "validation")},
            "origin": self.origin,
            "command": self.command,
            "commit": commit(),
            "data": {"train": self.train_views.describe(), "validation": self.validation_views.describe()},
            "versions": {"graspd_train": __version__, "python": platform.python_version(), "torch": str(torch.__version__), "numpy": np.__version__, "device": str(self.device)},
        })

    def learn(self, volume: torch.Tensor, batch: losses.Batch, steps_per_epoch: int) -> dict[str, float]:
        """One step of Adam."""
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(self.run, self.step, steps_per_epoch)
        self.net.train()
        answer = forward(self.net, volume, self.run, self.device)
        parts = losses.dense_losses(answer, batch, self.run.negative_weight) if self.run.dense else losses.sparse_losses(answer, batch)
        loss = sum(parts.values())
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        # oneDNN's bf16 convolutions give infinite gradients on tensors of 2³ cells: tiny volumes need f32.
        norm = nn.utils.clip_grad_norm_(self.net.parameters(), 10.0)
        if not torch.isfinite(norm):
            raise FloatingPointError(f"step {self.step}: found a gradient of norm {norm}, expected a number; the last checkpoint is {self.path}")
        self.optimizer.step()
        self.averaged.update(self.net, self.step)
        return {"loss": loss.item(), **{name: part.item() for name, part in parts.items()}}

    def train(self, stop_after_s: float, checkpoint_s: float, report) -> bool:
        """Trains to the end (true) or until time is up (false)."""
        began = kept = time.monotonic()
        run = self.run
        while self.epoch < run.epochs:
            if self.place == 0:
                self.train_views.refresh()
            views = min(run.views_per_epoch or len(self.train_views), len(self.train_views))
            steps_per_epoch = math.ceil(views / run.batch)
            before = time.monotonic()
            for volume, batch, taken in batches(self.train_views, run, self.epoch, self.device, self.place):
                for name, value in self.learn(volume, batch, steps_per_epoch).items():
                    self.totals[name] = self.totals.get(name, 0.0) + value * taken
                self.step, self.place, self.samples_seen = self.step + 1, self.place + taken, self.samples_seen + taken
                now = time.monotonic()
                self.seconds, before = self.seconds + now - before, now
                report(self, views)
                if now - kept > checkpoint_s:
                    self.keep()
                    kept = time.monotonic()
                if now - began > stop_after_s:
                    self.keep()
                    return False
            self.validation = validate(self.averaged.state, run, self.settings, self.validation_views, self.device)
            self.rows.append({
                "epoch": self.epoch + 1,
                "step": self.step,
                "samples": self.samples_seen,
                "rate": learning_rate(run, self.step - 1, steps_per_epoch),
                "seconds": round(self.seconds, 1),
                **{name: total / self.place for name, total in self.totals.items()},
                **self.validation,
            })
            self.epoch, self.place, self.totals = self.epoch + 1, 0, {}
            self.keep()
            kept = time.monotonic()
            write_curves(self.out, self.rows)
            report(self, views)
        return True


def _plain(value):
    return list(value) if isinstance(value, tuple) else value


def write_curves(out: Path, rows: list[dict]) -> None:
    """The curves as a table and as a picture."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with (out / "curves.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, names)
        table.writeheader()
        table.writerows(rows)
    draw(rows, out / "curves.png")


def progress(training: Training, views: int) -> None:
    """A line on the error stream that tells where training is."""
    if training.place == 0 and training.rows:
        row = training.rows[-1]
        told = "  ".join(f"{k} {v:.4f}" for k, v in row.items() if isinstance(v, float) and k not in ("seconds", "rate"))
        print(f"\r\x1b[Kepoch {row['epoch']}/{training.run.epochs}  {row['seconds']:.0f} s  {told}", file=sys.stderr)
    elif training.place:
        loss = training.totals["loss"] / training.place
        speed = training.samples_seen / max(training.seconds, 1e-9)
        end = "\r" if sys.stderr.isatty() else ("\n" if training.step % 50 == 0 else "")
        if end:
            print(f"\x1b[Kepoch {training.epoch + 1}  {training.place}/{views} views  loss {loss:.4f}  {speed:.2f} views/s", end=end, file=sys.stderr, flush=True)


def parse(arguments: list[str] | None) -> tuple[Run, argparse.Namespace]:
    """The command line."""
    default = {f.name: f.default for f in fields(Run)}
    p = argparse.ArgumentParser(prog="graspd_train.train", description="Trains a contact network.", formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--data", required=True, help="folder of shards of `graspd dataset generate`")
    p.add_argument("--validation", help="folder of shards to validate on; without it every twentieth scene of --data is kept for that")
    p.add_argument("--out", type=Path, required=True, help="folder of the run; an interrupted run in it goes on")
    p.add_argument("--from", dest="start", help="checkpoint of another run whose weights this one begins with, for example to go on with other objects")
    p.add_argument("--volume", choices=["tsdf", "occupancy"], default=default["volume"])
    p.add_argument("--orientation", choices=list(ORIENTATION_NUMBERS), default=default["orientation"])
    p.add_argument("--model", choices=["ours", "reference"], default=default["model"])
    p.add_argument("--widths", type=int, nargs=4, help="channels of the four levels, finest first")
    p.add_argument("--dense", action="store_true", help="learn from every voxel instead of the paper's samples")
    p.add_argument("--negative-weight", type=float, default=default["negative_weight"], help="with --dense: weight of a voxel without label")
    p.add_argument("--epochs", type=int, default=default["epochs"])
    p.add_argument("--views-per-epoch", type=int, help="that many random views are an epoch, not all")
    p.add_argument("--batch", type=int, default=default["batch"])
    p.add_argument("--rate", type=float, default=default["rate"], help="learning rate of Adam")
    p.add_argument("--schedule", choices=["halving", "cosine"], default=default["schedule"])
    p.add_argument("--halve-every", type=int, default=default["halve_every"], help="epochs")
    p.add_argument("--no-augment", dest="augment", action="store_false", help="without the eight symmetries about the vertical")
    p.add_argument("--precision", choices=["f32", "bf16"], default=default["precision"], help="bf16 is twice as fast where the processor has it")
    p.add_argument("--averaging", type=float, default=default["averaging"], help="decay of the averaged weights")
    p.add_argument("--seed", type=int, default=default["seed"])
    p.add_argument("--validation-views", type=int, default=default["validation_views"])
    p.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    p.add_argument("--threads", type=int, default=os.cpu_count(), help="CPU threads")
    p.add_argument("--stop-after", type=float, default=math.inf, help="minutes; the same command goes on later")
    p.add_argument("--checkpoint-every", type=float, default=5.0, help="minutes")
    options = p.parse_args(arguments)
    run = Run(**{f.name: getattr(options, f.name) for f in fields(Run)})
    if run.widths:
        run = Run(**{**asdict(run), "widths": tuple(run.widths)})
    return run, options


def main(arguments: list[str] | None = None) -> None:
    run, options = parse(arguments)
    torch.set_num_threads(options.threads)
    words = sys.argv[1:] if arguments is None else arguments
    training = Training(run, options.out, "python -m graspd_train.train " + " ".join(words), torch.device(options.device))
    (options.out / "run.json").write_text(json.dumps(asdict(run), indent=2) + "\n")
    if training.step:
        print(f"going on in epoch {training.epoch + 1} after {training.samples_seen} views", file=sys.stderr)
    if not training.train(options.stop_after * 60, options.checkpoint_every * 60, progress):
        print(f"\ntime is up in epoch {training.epoch + 1}; the same command goes on", file=sys.stderr)


if __name__ == "__main__":
    main()

"""Views per second of training on this machine: `python bench_training.py`, forward, loss, backward and Adam."""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
import torch

from graspd_train import losses, sampling, train
from graspd_train.models import SIDE, build
from graspd_train.sample import Sample


def made_up(rng: np.random.Generator) -> Sample:
    """A view with as many labels as real ones have."""
    index = np.sort(rng.choice(SIDE**3, 6000, replace=False))
    q = rng.normal(size=(6000, 4)).astype(np.float32)
    score = rng.random(6000).astype(np.float32)
    volume = rng.random((SIDE, SIDE, SIDE)).astype(np.float32)
    return Sample(volume, index, score, q / np.linalg.norm(q, axis=1, keepdims=True), index[:1500], score[:1500])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--models", nargs="+", default=["ours", "reference"])
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    device = torch.device(options.device)
    samples = [made_up(np.random.default_rng(k)) for k in range(4)]
    volume = torch.from_numpy(np.stack([s.volume for s in samples])[:, None])
    batch = losses.Batch.of([sampling.dense(s) for s in samples], SIDE**3, device)
    print("| network | precision | views/s, best | median |\n|---|---|---|---|")
    for model in options.models:
        for precision in ("f32", "bf16"):
            run = train.Run(data="", model=model, precision=precision)
            net = build(model, "quaternion").to(device, memory_format=torch.channels_last_3d)
            optimizer = torch.optim.Adam(net.parameters())
            times = []
            for _ in range(options.steps + 1):
                began = time.perf_counter()
                answer = train.forward(net, volume, run, device)
                loss = sum(losses.dense_losses(answer, batch, 0.1).values())
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                optimizer.step()
                loss.item()
                times.append(time.perf_counter() - began)
            times = sorted(times[1:])
            print(f"| {model} | {precision} | {4 / times[0]:.2f} | {4 / times[len(times) // 2]:.2f} |", flush=True)


if __name__ == "__main__":
    main()

"""Times one network under several runtimes, in turns: `python bench_runtimes.py [--model MODEL.onnx] [--threads 2]`.

graspd's own inference, tract and products of matrices by the gemm crate (built beforehand, see docs/inference.md),
ONNX Runtime and OpenVINO from PyPI. They take turns, round after round, so that a noisy machine is as noisy for
all of them; the best time of each is what a quiet machine gives, the median what this one gave. Answers are compared.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import onnxruntime
import openvino
import torch

from graspd_train.export import to_onnx, write
from graspd_train.golden import randomized, volume
from graspd_train.models import SIDE, build

ROOT = Path(__file__).parents[2]
INFER = ROOT / "target/release/examples/infer"
CANDIDATES = ROOT / "inference/candidates/target/release/candidates"
OUTPUTS = ["certainty", "centroid", "orientation"]


def timed(run, runs: int) -> list[float]:
    """Milliseconds of each run."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        run()
        times.append((time.perf_counter() - began) * 1e3)
    return times


def program(*words) -> list[float]:
    """Milliseconds that a program of ours prints, but for the first."""
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{words[0]}: {done.stderr.strip()[-300:]}")
    return [float(line) for line in done.stdout.split()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--model", type=Path, help="an exported model; without it our network with random weights")
    parser.add_argument("--network", choices=["ours", "reference"], default="ours", help="which one, without --model")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=10, help="runs of each runtime in a round")
    options = parser.parse_args()
    threads = options.threads

    folder = Path(tempfile.mkdtemp())
    path = options.model
    if path is None:
        torch.manual_seed(1)
        path = folder / "model.onnx"
        write(to_onnx(randomized(build(options.network, "quaternion"), 32), "tsdf", "quaternion"), path)
    values = volume(SIDE)
    values.tofile(folder / "volume.f32")
    values = values[None, None]

    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])

    def compiled(precision: str):
        hints = {"INFERENCE_NUM_THREADS": threads, "PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": precision}
        return openvino.Core().compile_model(path, "CPU", hints).create_infer_request()

    openvinos = {precision: compiled(precision) for precision in ("f32", "bf16")}
    output = folder / "answer.f32"
    runtimes = {
        "graspd-inference": lambda: program(INFER, path, folder / "volume.f32", output, options.runs, threads),
        "OpenVINO, f32": lambda: timed(lambda: openvinos["f32"].infer({"volume": values}), options.runs),
        "OpenVINO, bf16": lambda: timed(lambda: openvinos["bf16"].infer({"volume": values}), options.runs),
        "ONNX Runtime": lambda: timed(lambda: session.run(OUTPUTS, {"volume": values}), options.runs),
    }
    if CANDIDATES.exists():
        few = max(2, options.runs // 5)
        runtimes["tract"] = lambda: program(CANDIDATES, "tract", path, folder / "volume.f32", few, threads)
        runtimes["gemm, products alone"] = lambda: program(CANDIDATES, "gemm", path, folder / "volume.f32", options.runs, threads)[1:]

    times: dict[str, list[float]] = {name: [] for name in runtimes}
    for _ in range(options.rounds):
        for name, run in list(runtimes.items()):
            try:
                times[name] += run()
            except RuntimeError as error:
                print(f"{name} fails: {error}")
                del runtimes[name]

    expected = dict(zip(OUTPUTS, session.run(OUTPUTS, {"volume": values}), strict=True))
    voxels = SIDE**3
    found = np.fromfile(output, "<f4")
    ours = {
        "certainty": found[:voxels],
        "centroid": found[voxels : 2 * voxels],
        "orientation": found[2 * voxels :].reshape(voxels, -1).T,
    }
    away = max(float(np.abs(ours[name].ravel() - expected[name].ravel()).max()) for name in OUTPUTS)
    print(f"\n{path}, {threads} threads, {options.rounds} rounds; greatest difference from ONNX Runtime {away:.1e}\n")
    print("| runtime | best, ms | median, ms | speed, OpenVINO f32 = 1 |\n|---|---|---|---|")
    base = statistics.median(times["OpenVINO, f32"])
    for name, each in times.items():
        if each:
            print(f"| {name} | {min(each):.1f} | {statistics.median(each):.1f} | {base / statistics.median(each):.2f} |")


if __name__ == "__main__":
    main()

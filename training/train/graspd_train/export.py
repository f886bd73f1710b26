"""One trained network as one ONNX file, batch norms folded, with a model card beside it.

`python -m graspd_train.export CHECKPOINT --out MODEL.onnx`

The graph is written operator by operator, not traced: the same weights give the same bytes, and nothing but Conv,
ConvTranspose, Add, Relu, MaxPool, Concat, Split and Sigmoid occurs in it, which is all that graspd's own inference
knows. Input `volume` [1, 1, n, n, n]; outputs `certainty` and `centroid` [1, 1, n, n, n], each after its sigmoid, and
`orientation` [1, 4 or 6, n, n, n], not normalized (see models.py). The file's metadata says what volume it wants and
what its orientation means, and has a CRC-32 over the whole file, by which damaged files are noticed.
"""

from __future__ import annotations

import argparse
import json
import zlib
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from . import __version__
from .models import ORIENTATION_NUMBERS, SIDE, ContactNet, Conv, ReferenceUNet, Residual, Up, build, gflop

# Version of what the metadata means; graspd refuses what it does not know.
FORMAT_VERSION = 1

# What the numbers of a volume mean, by its kind.
VOLUMES = {
    "tsdf": "truncated signed distance, 0 to 1: 0 unseen or beyond the truncation, 0.5 at the surface",
    "occupancy": "1 occupied or unseen, 0 seen to be free",
}


def folded(conv: nn.Module, norm: nn.BatchNorm3d | None) -> tuple[np.ndarray, np.ndarray]:
    """Weight and bias of a convolution with the batch norm after it, in double precision until the end."""
    weight = conv.weight.detach().double()
    bias = torch.zeros(conv.out_channels).double() if conv.bias is None else conv.bias.detach().double()
    if norm is not None:
        scale = norm.weight.detach().double() / torch.sqrt(norm.running_var.double() + norm.eps)
        bias = (bias - norm.running_mean.double()) * scale + norm.bias.detach().double()
        # A transposed convolution keeps its output channels second.
        shape = (1, -1, 1, 1, 1) if isinstance(conv, nn.ConvTranspose3d) else (-1, 1, 1, 1, 1)
        weight = weight * scale.reshape(shape)
    return weight.float().numpy(), bias.float().numpy()


class Graph:
    """Nodes and weights as they are added; every method returns the name of what it computes."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []

    def add(self, operator: str, inputs: list[str], outputs: list[str] | None = None, **attributes) -> str:
        outputs = outputs or [f"t{len(self.nodes)}"]
        self.nodes.append(helper.make_node(operator, inputs, outputs, name=f"n{len(self.nodes)}", **attributes))
        return outputs[0]

    def weight(self, values: np.ndarray) -> str:
        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def conv(self, x: str, conv: nn.Module, norm: nn.BatchNorm3d | None = None) -> str:
        weight, bias = folded(conv, norm)
        inputs = [x, self.weight(weight)]
        if np.any(bias) or norm is not None or conv.bias is not None:
            inputs.append(self.weight(bias))
        return self.add(
            "ConvTranspose" if isinstance(conv, nn.ConvTranspose3d) else "Conv",
            inputs,
            kernel_shape=list(conv.kernel_size),
            strides=list(conv.stride),
            pads=list(conv.padding) * 2,
        )

    def block(self, x: str, block: Conv) -> str:
        return self.add("Relu", [self.conv(x, block[0], block[1])])

    def residual(self, x: str, block: Residual) -> str:
        y = self.conv(self.block(x, block.first), block.second, block.norm)
        return self.add("Relu", [self.add("Add", [y, x])])

    def up(self, x: str, skip: str, block: Up) -> str:
        return self.add("Relu", [self.add("Add", [self.conv(x, block.up, block.norm), skip])])

    def ours(self, net: ContactNet, x: str) -> str:
        def stage(y: str, down: Conv, blocks: nn.Sequential) -> str:
            y = self.block(y, down)
            for block in blocks:
                y = self.residual(y, block)
            return y

        x0 = self.block(x, net.stem)
        x1 = stage(x0, net.down1, net.encode1)
        x2 = stage(x1, net.down2, net.encode2)
        x3 = stage(x2, net.down3, net.encode3)
        y = self.block(self.up(x3, x2, net.up2), net.decode2)
        y = self.block(self.up(y, x1, net.up1), net.decode1)
        y = self.block(self.up(y, x0, net.up0), net.decode0)
        features, raw = self.conv(y, net.features, net.features_norm), self.conv(x, net.raw)
        return self.conv(self.add("Relu", [self.add("Add", [features, raw])]), net.head)

    def reference(self, net: ReferenceUNet, x: str) -> str:
        skips = []
        for double in net.encode:
            x = self.block(self.block(x, double[0]), double[1])
            skips.append(x)
            x = self.add("MaxPool", [x], kernel_shape=[2, 2, 2], strides=[2, 2, 2])
        x = self.block(self.block(x, net.bottom[0]), net.bottom[1])
        for up, double, skip in zip(net.up, net.decode, reversed(skips), strict=True):
            x = self.add("Concat", [self.conv(x, up), skip], axis=1)
            x = self.block(self.block(x, double[0]), double[1])
        return self.conv(x, net.head)


def signed(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model with its own checksum: CRC-32 of the file's bytes with eight zeros in the checksum's place."""
    entry = next(p for p in model.metadata_props if p.key == "graspd.crc32")
    entry.value = "0" * 8
    entry.value = f"{zlib.crc32(model.SerializeToString(deterministic=True)):08x}"
    return model


def write(model: onnx.ModelProto, path: Path) -> None:
    """Writes a model so that its checksum holds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(signed(model).SerializeToString(deterministic=True))


def to_onnx(net: nn.Module, volume: str, orientation: str, side: int = SIDE, metadata: dict | None = None):
    """The network as an ONNX model; `metadata` is added to what every file says of itself."""
    if volume not in VOLUMES:
        raise ValueError(f"volume: found {volume!r}, expected one of {sorted(VOLUMES)}")
    net = net.eval().cpu()
    graph = Graph()
    answer = graph.ours(net, "volume") if isinstance(net, ContactNet) else graph.reference(net, "volume")
    numbers = ORIENTATION_NUMBERS[orientation]
    sizes = numpy_helper.from_array(np.array([1, 1, numbers], dtype=np.int64), "sizes")
    graph.add("Split", [answer, "sizes"], ["certainty_logit", "centroid_logit", "orientation"], axis=1)
    graph.add("Sigmoid", ["certainty_logit"], ["certainty"])
    graph.add("Sigmoid", ["centroid_logit"], ["centroid"])

    def value(name: str, depth: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, depth, side, side, side])

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "graspd-contacts",
            [value("volume", 1)],
            [value("certainty", 1), value("orientation", numbers), value("centroid", 1)],
            [*graph.weights, sizes],
        ),
        opset_imports=[helper.make_opsetid("", 17)],
        producer_name="graspd",
        producer_version=__version__,
        ir_version=8,
    )
    entries = {
        "graspd.format": FORMAT_VERSION,
        "graspd.volume": volume,
        "graspd.orientation": orientation,
        "graspd.side": side,
        "graspd.crc32": "0" * 8,
        **(metadata or {}),
    }
    helper.set_model_props(model, {key: str(value) for key, value in entries.items()})
    onnx.checker.check_model(model, full_check=True)
    return signed(model)


def describe(card: dict) -> str:
    """The model card for people."""
    lines = [f"# {card['name']}", "", card["about"], "", "| | |", "|---|---|"]
    for key, value in card.items():
        if key in ("name", "about", "validation", "command"):
            continue
        lines.append(f"| {key.replace('_', ' ')} | {json.dumps(value) if isinstance(value, (dict, list)) else value} |")
    lines += ["", "Validation (Supplementary Note 2):", "", "| E_Pc | E_Pe | E_Angle |", "|---|---|---|"]
    metrics = card.get("validation") or {}
    lines.append("| " + " | ".join(f"{metrics[k]:.4f}" if k in metrics else "–" for k in ("e_pc", "e_pe", "e_angle")) + " |")
    lines += ["", "```sh", card.get("command") or "", "```", ""]
    return "\n".join(lines)


def model_card(name: str, checkpoint: dict, net: nn.Module, model: onnx.ModelProto) -> dict:
    """What one has to know of a model, and to make it again."""
    run = checkpoint["run"]
    props = {p.key: p.value for p in model.metadata_props}
    return {
        "name": name,
        "about": f"Contact certainty, contact orientation ({run['orientation']}) and contact centroids from a "
        f"{run['volume']} volume of {props['graspd.side']}³ voxels: {VOLUMES[run['volume']]}.",
        "volume": run["volume"],
        "orientation": run["orientation"],
        "network": {"model": run["model"], **net.settings},
        "gflop": round(gflop(net, int(props["graspd.side"])), 3),
        "parameters": sum(p.numel() for p in net.parameters()),
        "epochs": checkpoint["epoch"],
        "samples_seen": checkpoint["samples_seen"],
        "seed": run["seed"],
        "commit": checkpoint["commit"],
        "data": checkpoint["data"],
        "began_from": checkpoint.get("origin"),
        "versions": checkpoint["versions"],
        "crc32": props["graspd.crc32"],
        "validation": checkpoint.get("validation"),
        "command": checkpoint["command"],
    }


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="ONNX file; the card goes beside it as .json and .md")
    options = parser.parse_args(arguments)

    checkpoint = torch.load(options.checkpoint, map_location="cpu", weights_only=True)
    run = checkpoint["run"]
    net = build(run["model"], run["orientation"], **checkpoint["settings"])
    net.load_state_dict(checkpoint["averaged"])
    model = to_onnx(net, run["volume"], run["orientation"], metadata={"graspd.commit": checkpoint["commit"]})
    write(model, options.out)
    card = model_card(options.out.stem, checkpoint, net, model)
    options.out.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")
    options.out.with_suffix(".md").write_text(describe(card))
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB, {card['gflop']} GFLOP, CRC-32 {card['crc32']}")


if __name__ == "__main__":
    main()

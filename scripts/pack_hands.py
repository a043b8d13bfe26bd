"""A hand network's weights for training elsewhere: from TFLite to safetensors, in half precision.

    python scripts/pack_hands.py MODELS/hand_landmark_full.tflite PACKED/hands.safetensors

The file's metadata holds the layers in order. Needs the package `tflite`.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file

from data_prep.errors import call_script


def layers_of(path: Path) -> tuple[list[dict[str, Any]], dict[str, torch.Tensor]]:
    """Layers of a TFLite network of convolutions, sums, one mean and dense outputs."""
    import tflite

    model = tflite.Model.GetRootAsModel(path.read_bytes(), 0)
    graph = model.Subgraphs(0)
    kinds = {v: k for k, v in vars(tflite.BuiltinOperator).items() if not k.startswith("_")}
    whole: dict[int, int] = {}
    layers: list[dict[str, Any]] = []
    weights: dict[str, torch.Tensor] = {}

    def array(index: int) -> np.ndarray:
        tensor = graph.Tensors(whole.get(index, index))
        kind = np.float16 if tensor.Type() == tflite.TensorType.FLOAT16 else np.float32
        data = model.Buffers(tensor.Buffer()).DataAsNumpy()
        return np.frombuffer(data.tobytes(), kind).reshape(tensor.ShapeAsNumpy())

    for i in range(graph.OperatorsLength()):
        operator = graph.Operators(i)
        code = model.OperatorCodes(operator.OpcodeIndex())
        kind = kinds[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
        inputs, output = operator.InputsAsNumpy().tolist(), int(operator.Outputs(0))
        if kind == "DEQUANTIZE":
            whole[output] = inputs[0]
            continue
        layer: dict[str, Any] = {"kind": kind, "inputs": inputs[:1], "output": output}
        if kind == "ADD":
            layer["inputs"] = inputs
        if kind in ("CONV_2D", "DEPTHWISE_CONV_2D"):
            plain = kind == "CONV_2D"
            options = tflite.Conv2DOptions() if plain else tflite.DepthwiseConv2DOptions()
            options.Init(operator.BuiltinOptions().Bytes, operator.BuiltinOptions().Pos)
            layer["stride"] = options.StrideH()
            layer["relu6"] = (
                options.FusedActivationFunction() == tflite.ActivationFunctionType.RELU6
            )
            order = (0, 3, 1, 2) if kind == "CONV_2D" else (3, 0, 1, 2)
            weights[f"{output}.weight"] = torch.from_numpy(array(inputs[1]).transpose(order).copy())
            weights[f"{output}.bias"] = torch.from_numpy(array(inputs[2]).copy())
        if kind == "FULLY_CONNECTED":
            weights[f"{output}.weight"] = torch.from_numpy(array(inputs[1]).copy())
            weights[f"{output}.bias"] = torch.from_numpy(array(inputs[2]).copy())
        layers.append(layer)
    return layers, weights


def main() -> None:
    """Convert one file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("network", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    layers, weights = layers_of(given.network)
    tensors = {k: v.half().contiguous() for k, v in weights.items()}
    save_file(tensors, given.out, metadata={"layers": json.dumps(layers)})


if __name__ == "__main__":
    call_script(main)

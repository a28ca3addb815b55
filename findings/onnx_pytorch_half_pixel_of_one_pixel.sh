#!/usr/bin/env bash
# onnxruntime 1.32.0 (CPU) with onnx 1.23.2 and torch 2.13.0: Resize with "pytorch_half_pixel" to one pixel is the first pixel, and PyTorch's the middle.
# Believed: coordinate_transformation_mode="pytorch_half_pixel" is what PyTorch does, for which it is named and chosen. Seen: a
# row of 0 to 13 that becomes one pixel is 0, by linear and by cubic, and F.interpolate(align_corners=False) gives 6.5, as "half_pixel" does. The rule is
# that of the ONNX standard, which puts an axis of length 1 at 0, and PyTorch has none such. The other axis of 1 x 5 pixels agrees, and so do sizes
# from 2 on. A feature map that is pooled to one pixel shows its upper left corner.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet onnxruntime==1.32.0 onnx==1.23.2 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper

print("onnxruntime", onnxruntime.__version__, "onnx", onnx.__version__, "torch", torch.__version__)


def resize(image, size, mode, coordinates):
    inputs = {"image": image[None, None], "sizes": np.array([1, 1, *size], np.int64)}
    values = [
        helper.make_tensor_value_info("image", TensorProto.FLOAT, inputs["image"].shape),
        helper.make_tensor_value_info("sizes", TensorProto.INT64, [4]),
    ]
    weights = {"cubic_coeff_a": -0.75} if mode == "cubic" else {}
    node = helper.make_node("Resize", ["image", "", "", "sizes"], ["small"], mode=mode, coordinate_transformation_mode=coordinates, **weights)
    graph = helper.make_graph([node], "graph", values, [helper.make_tensor_value_info("small", TensorProto.FLOAT, None)])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 19)], ir_version=10)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(None, inputs)[0][0, 0]


image = np.tile(np.arange(14, dtype=np.float32), (12, 1)) + 100 * np.arange(12, dtype=np.float32)[:, None]
for mode, name in (("linear", "bilinear"), ("cubic", "bicubic")):
    for size in ((12, 1), (1, 1), (1, 5), (2, 2), (3, 5)):
        torchs = torch.nn.functional.interpolate(torch.tensor(image)[None, None], size, mode=name, align_corners=False)[0, 0].numpy()
        found = {coordinates: resize(image, size, mode, coordinates) for coordinates in ("pytorch_half_pixel", "half_pixel")}
        first = {coordinates: result[0, 0].round(2) for coordinates, result in found.items()}
        print(f"{mode} to {size[0]} x {size[1]}, first pixel: PyTorch {torchs[0, 0]:.2f},", ", ".join(f"{a} {b:.2f}" for a, b in first.items()))
        assert np.allclose(found["half_pixel"], torchs, atol=1e-2)
        assert np.allclose(found["pytorch_half_pixel"], torchs, atol=1e-2) == (1 not in size)
        if size == (1, 1):
            assert abs(found["pytorch_half_pixel"]).max() < 1e-3 and abs(torchs - 556.5).max() < 1e-2
PROGRAM

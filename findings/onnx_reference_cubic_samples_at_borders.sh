#!/usr/bin/env bash
# onnx 1.23.2 with onnxruntime 1.32.0 and torch 2.13.0: its reference of GridSample, cubic with padding_mode="border", is not what PyTorch and onnxruntime do.
# Believed: onnx.reference is what an implementation is to be compared with, and GridSample was made for PyTorch's grid_sample. Seen of a grid that leaves the
# image by up to a third: it is up to .08 off of random numbers in 0..1 near the border and beyond, where onnxruntime and PyTorch are within
# 1e-6 of each other; with "zeros" and "reflection", and by "linear" and "nearest", all three agree. The reference moves the position into the image
# before it takes its 4 x 4 pixels, and the others each of the pixels.
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
from onnx.reference import ReferenceEvaluator

print("onnx", onnx.__version__, "onnxruntime", onnxruntime.__version__, "torch", torch.__version__)
random = np.random.default_rng(0)
inputs = {"image": random.random((1, 2, 12, 14)).astype(np.float32), "grid": random.uniform(-1.3, 1.3, (1, 30, 30, 2)).astype(np.float32)}
inside = abs(inputs["grid"]).max(-1) < 0.7
values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, value.shape) for name, value in inputs.items()]
for mode, name in (("cubic", "bicubic"), ("linear", "bilinear"), ("nearest", "nearest")):
    for padding in ("zeros", "border", "reflection"):
        node = helper.make_node("GridSample", list(inputs), ["samples"], mode=mode, padding_mode=padding)
        graph = helper.make_graph([node], "graph", values, [helper.make_tensor_value_info("samples", TensorProto.FLOAT, None)])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        reference = ReferenceEvaluator(model).run(None, inputs)[0]
        runtime = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(None, inputs)[0]
        image, grid = (torch.tensor(value) for value in inputs.values())
        torchs = torch.nn.functional.grid_sample(image, grid, mode=name, padding_mode=padding, align_corners=False).numpy()
        off = abs(reference - torchs)
        apart = abs(runtime - torchs).max()
        print(f"{mode}, {padding}: reference {off.max():.6f} from PyTorch, {off[:, :, inside[0]].max():.6f} inside, onnxruntime {apart:.6f}")
        assert apart < 1e-5 and off[:, :, inside[0]].max() < 1e-5
        assert (off.max() > 0.03) == (mode == "cubic" and padding == "border")
PROGRAM

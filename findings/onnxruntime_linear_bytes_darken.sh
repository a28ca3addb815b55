#!/usr/bin/env bash
# onnxruntime 1.32.0 (CPU) with onnx 1.23.2: linear Resize of uint8 cuts off the fraction instead of rounding.
# Believed: an image in bytes resized inside of the model is the one resized in floats, rounded to whole levels, as OpenCV, Pillow and
# torchvision do and as onnxruntime itself does with antialias=1. Seen: every value is rounded down, .47 levels too dark on average at
# scale 2, and each further resize takes as much again: after five times up by 1.25 and back the mean has lost more than 4 levels of 255.
# int8 is rounded to zero, which makes the dark half brighter. Cast to float before a Resize, or set antialias=1 where it shrinks.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import onnxruntime
from onnx import TensorProto, helper

print("ONNX Runtime", onnxruntime.__version__)


def resized(image, scale, **options):
    kind = helper.np_dtype_to_tensor_dtype(image.dtype)
    node = helper.make_node("Resize", ["x", "", "scales"], ["y"], mode="linear", **options)
    scales = helper.make_tensor("scales", TensorProto.FLOAT, [4], [1, 1, scale, scale])
    ends = helper.make_tensor_value_info("x", kind, image.shape), helper.make_tensor_value_info("y", kind, None)
    graph = helper.make_graph([node], "resize", ends[:1], ends[1:], [scales])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 19)], ir_version=9)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(None, {"x": image})[0]


image = np.random.default_rng(0).integers(0, 256, (1, 3, 40, 50), dtype=np.uint8)
for scale in (2.0, 0.5):
    bytes_, floats = resized(image, scale).astype(np.float32), resized(image.astype(np.float32), scale)
    print(f"scale {scale}: bytes minus floats {(bytes_ - floats).mean():.2f} on average; rounded down: {(bytes_ == np.floor(floats)).all()}")
    assert (bytes_ == np.floor(floats)).all() and (bytes_ - floats).mean() < -0.3
smooth = resized(image, 0.5, antialias=1).astype(np.float32) - resized(image.astype(np.float32), 0.5, antialias=1)
print(f"scale 0.5 with antialias: bytes minus floats {smooth.mean():.2f} on average")
assert abs(smooth.mean()) < 0.2

signed = (image.astype(np.int16) - 128).astype(np.int8)
difference = resized(signed, 2.0).astype(np.float32) - resized(signed.astype(np.float32), 2.0)
negative = resized(signed.astype(np.float32), 2.0) < 0
print(f"int8: {difference[negative].mean():+.2f} where negative, {difference[~negative].mean():+.2f} elsewhere")
assert difference[negative].mean() > 0.3 and difference[~negative].mean() < -0.3

again = image
for _ in range(5):
    again = resized(resized(again, 1.25), 0.8)
print(f"mean {image.mean():.2f}; after five times up by 1.25 and back {again.mean():.2f}")
assert again.mean() < image.mean() - 4
PROGRAM

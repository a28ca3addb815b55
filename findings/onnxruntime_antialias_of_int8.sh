#!/usr/bin/env bash
# onnxruntime 1.32.0 (CPU) with onnx 1.23.2: Resize with antialias of int8 turns every negative value into 0.
# Believed: Resize of signed bytes, which its specification allows and quantized models have, is that of the same numbers as floats, rounded, and
# a flat image keeps its value. Seen: where antialias=1 results are clamped to 0..255, as if the bytes were unsigned: a flat -50
# becomes 0, by "linear" and by "cubic", and so does an edge of 20 and 127 where "cubic" overshoots to 134. int32 and float are right, and
# int8 is without antialias, as it is in onnx's own ReferenceEvaluator. Resize in floats, outside of the quantized part.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import onnxruntime
from onnx import TensorProto, helper
from onnx.reference import ReferenceEvaluator

print("ONNX Runtime", onnxruntime.__version__)


def resized(image, reference=False, **options):
    kind = helper.np_dtype_to_tensor_dtype(image.dtype)
    node = helper.make_node("Resize", ["x", "", "scales"], ["y"], **options)
    scales = helper.make_tensor("scales", TensorProto.FLOAT, [4], [1, 1, 0.5, 0.5])
    ends = helper.make_tensor_value_info("x", kind, image.shape), helper.make_tensor_value_info("y", kind, None)
    graph = helper.make_graph([node], "resize", ends[:1], ends[1:], [scales])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 19)], ir_version=9)
    if reference:
        return ReferenceEvaluator(model).run(None, {"x": image})[0]
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"]).run(None, {"x": image})[0]


flat = np.full((1, 1, 8, 8), -50)
for mode in ("linear", "cubic"):
    seen = {kind.__name__: np.unique(resized(flat.astype(kind), mode=mode, antialias=1)).tolist() for kind in (np.int8, np.int32, np.float32)}
    seen["reference"] = np.unique(np.round(resized(flat.astype(np.int8), True, mode=mode, antialias=1))).tolist()
    print(mode, "of a flat -50 with antialias:", seen)
    assert seen["int8"] == [0] and seen["int32"] == [-50] and seen["float32"] == [-50] and seen["reference"] == [-50]
assert (resized(flat.astype(np.int8), mode="linear") == -50).all()
edge = np.where(np.arange(32) % 11 < 5, 20, 127)[None, None, None].repeat(32, 2)
row = resized(edge.astype(np.int8), mode="cubic", antialias=1)[0, 0, 8].tolist()
exact = resized(edge.astype(np.float32), mode="cubic", antialias=1)[0, 0, 8].round(1).tolist()
print("cubic overshoot:", row, "of floats", exact)
assert min(exact) > 10 and all(value == 0 for value, right in zip(row, exact) if right > 128) and max(exact) > 134
PROGRAM

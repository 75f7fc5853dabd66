"""Run a trained compensator with onnxruntime and numpy alone: what a sample costs, is it right.

python examples/compensate_with_onnxruntime.py MODEL_FOLDER
"""

import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime

folder, options = Path(*sys.argv[1:2] or ["model"]), onnxruntime.SessionOptions()
options.intra_op_num_threads = 1  # a sample is too little work to share
if not (folder / "model.onnx").is_file():
    sys.exit(f"{folder}: no model.onnx here; train one: uavtwin train FLIGHT... --vehicle V")
session = onnxruntime.InferenceSession(str(folder / "model.onnx"), options)
reference = dict(np.load(folder / "reference.npz"))
inputs = ("virtual", "command", "phase", "measured", "valid")
n, wrong, begin = len(reference["phase"]), 0.0, time.perf_counter()
size = next(i.shape[1] for i in session.get_inputs() if i.name == "state")
state = np.zeros((1, size), np.float32)  # the first axis, "batch", may be any number of aircraft
for k in range(n):
    now = {name: reference[name][k : k + 1] for name in inputs}
    correction, spread, anomaly, inside, state = session.run(None, {**now, "state": state})
    wrong = max(wrong, float(np.abs(correction - reference["correction"][k]).max()))
print(f"{n} samples, {1e3 * (time.perf_counter() - begin) / n:.3f} ms each")
print(f"correction within {wrong:.1e} of the reference")

"""Export of a trained compensator as ONNX."""

"""A trained compensator as ONNX."""

"""DataFlash files: definitions, and the messages that they describe, binary or text."""

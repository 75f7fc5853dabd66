"""The site that `serve` and `live` are pages of: who may ask, with what limits, and its server."""

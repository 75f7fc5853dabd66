"""Site with the pages of `serve` and `live`: access rules, limits, and its server."""

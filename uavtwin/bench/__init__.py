"""`uavtwin bench`: figures measured here and now."""

"""Causes of a failed flight, from its log alone: no vehicle file, no mass, no size."""

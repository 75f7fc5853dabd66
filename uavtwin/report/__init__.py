"""Presentation of results: words, figures, pages."""

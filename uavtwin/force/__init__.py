"""Learned force and moment: laws that flights teach, chosen and judged by FMUs that fly them."""

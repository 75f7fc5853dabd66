"""What `twin.explain` says about recorded flights; run by `docs/_generate/real_flights.py`."""

"""What `twin.explain` says about recorded flights: `python docs/real_flights.py`."""

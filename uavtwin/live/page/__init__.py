"""The page of a live flight: what it shows, and the small server that it comes from."""

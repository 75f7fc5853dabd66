"""A page where logs are dropped: what it stores, what it does with each, and its small server."""

"""A fleet with planted drifts: are they found, and what does a log cost?"""

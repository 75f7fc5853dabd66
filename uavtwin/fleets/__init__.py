"""Many logs of many aircraft: each checked, compared and explained, and what they say together."""

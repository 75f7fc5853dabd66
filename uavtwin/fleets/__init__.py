"""Analysis of many logs of many aircraft: each checked, compared and explained, with joint
statistics."""

"""Many runs of a scenario: what is varied, on which engine, and the table that comes of it."""

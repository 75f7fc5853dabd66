"""Many runs of a scenario: design, engine and table of the results."""

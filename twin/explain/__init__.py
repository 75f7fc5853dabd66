"""Find where a twin and its flights disagree, and name the missing physical effect."""

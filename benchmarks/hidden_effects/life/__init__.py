"""What real aircraft have beside what is hidden: files that are off, days, missing sensors."""

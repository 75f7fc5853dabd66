"""What a learned force is worth: exported FMUs, flown over flights that taught them nothing."""

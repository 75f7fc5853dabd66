"""Series of results as files: columns over time in Parquet, CSV or MCAP, flights in MCAP."""

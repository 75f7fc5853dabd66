"""Python-slave FMUs: prototypes and a fallback, run by pythonfmu."""

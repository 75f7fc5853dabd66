"""Why a flight went wrong, from its log alone: no vehicle file, no mass, no size."""

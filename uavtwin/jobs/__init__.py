"""Many independent jobs on local processes or a cluster, each done once despite interruptions."""

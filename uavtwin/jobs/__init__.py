"""Many independent jobs: on processes here or on a cluster, each done once whatever is killed."""

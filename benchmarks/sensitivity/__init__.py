"""What `explain` says about hidden effects when each of its settings is halved and doubled."""

"""What figures of pages are made of: thinned series, panels, tracks in space."""

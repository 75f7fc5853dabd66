"""Web page of a live flight: its content, and its small server."""

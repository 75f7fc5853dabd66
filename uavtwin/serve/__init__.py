"""Web page for uploaded logs: store, analysis, and a small server."""

"""Live twin of a flying aircraft over MAVLink, and replay of a log as such an aircraft."""

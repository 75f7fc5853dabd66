"""What is wrong, while it flies: evidence that grows second by second, and alarms with a name."""

"""The process itself: signals that stop it, and the status line of a terminal."""

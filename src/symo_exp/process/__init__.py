"""The process itself: signals that stop it, the status line and the width of a terminal."""

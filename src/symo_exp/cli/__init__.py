"""The command line: words to a command, its errors in one line, help."""

"""Tables, figures and pages of runs, and pictures of single runs."""

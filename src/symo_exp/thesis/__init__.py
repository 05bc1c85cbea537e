"""Chapter 6 of the thesis; no other package imports this one."""

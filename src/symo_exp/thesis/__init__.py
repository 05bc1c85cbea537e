"""Chapter 6 of the thesis, as a guest: it imports the framework, and nothing imports it."""

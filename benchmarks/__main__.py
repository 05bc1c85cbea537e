"""`python -m benchmarks [--quick]`: see `benchmarks.run`."""

from benchmarks.run import main

main()

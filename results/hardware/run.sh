#!/usr/bin/env bash
# A model of each machine of this page by the one command:  results/hardware/run.sh SEEDS
set -euo pipefail
results/machines/run.sh 10min "$1" recordings/*_pendulum.parquet

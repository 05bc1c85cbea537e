#!/usr/bin/env bash
# A model of each machine by the one command:  results/machines/run.sh BUDGET SEEDS MACHINE...
set -euo pipefail
budget=$1 seeds=$2
shift 2
for machine in "$@"; do
  for seed in ${seeds//,/ }; do
    reference=none
    [ -f "conf/reference/$machine.yaml" ] && reference=$machine
    python -m symo_exp -cn machine data.path="recordings/$machine.parquet" reference="$reference" \
      budget="$budget" seed="$seed" experiment="machines/$machine/$seed" logger=none
  done
done

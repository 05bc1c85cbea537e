#!/usr/bin/env bash
# A model of each machine by the one command:  results/machines/run.sh BUDGET SEEDS FILE...
# SETTINGS='hydra/launcher=basic' in the environment adds settings to every search.
set -euo pipefail
budget=$1 seeds=$2
shift 2
for file in "$@"; do
  machine=$(basename "$file" .parquet)
  for seed in ${seeds//,/ }; do
    reference=none
    [ -f "conf/reference/$machine.yaml" ] && reference=$machine
    python -m symo_exp -cn machine data.path="$file" reference="$reference" budget="$budget" seed="$seed" \
      experiment="machines/$machine/$seed" logger=none ${SETTINGS:-} || [ $? -eq 1 ] # no model
  done
done

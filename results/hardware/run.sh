#!/usr/bin/env bash
# The runs of this page:  results/hardware/run.sh SEEDS METHOD MACHINE...
# What belongs to a machine was chosen by the errors of rollouts on its validation part, seed 0.
set -euo pipefail
seeds=$1 method=$2
shift 2
for machine in "$@"; do
  case $machine in
    free_single_pendulum) own=(integrator=galerkin4) ;;
    free_*) own=(integrator=galerkin4 dissipation.joints=neighbours) ;;
    motor_pendulum) own=(integrator=midpoint) ;;
    motor_double_pendulum)
      own=(integrator=midpoint model.width=2 model.depth=1 harmonics=1 dissipation=friction
        optimizer.starts=6) ;;
  esac
  explicit=(integrator=rk4)
  case $method in
    symo) how=("${own[@]}") ;;
    symo-none) how=("${own[@]}" dissipation=none) ;;
    symo-smoothed) how=("${own[@]}" 'optimizer.epsilons=[]') ;;
    l_node) how=(model=l_node "${own[@]}" "${explicit[@]}") ;;
    l_node-estimated) how=(model=l_node "${own[@]}" "${explicit[@]}" data.velocities=estimated) ;;
    node) how=(model=node model.width=32 "${explicit[@]}") ;;
    node-estimated) how=(model=node model.width=32 "${explicit[@]}" data.velocities=estimated) ;;
    e2e_symo) how=(model=e2e_symo "${own[@]}" optimizer=levenberg_marquardt) ;;
    e2e_symo-none) how=(model=e2e_symo "${own[@]}" optimizer=levenberg_marquardt dissipation=none) ;;
  esac
  python -m symo_exp data=recorded system=recorded system.angular=all system.time_step=0.02 \
    preset=recorded data.path="recordings/$machine.parquet" reference="$machine" \
    experiment="hardware_$method" seed="$seeds" pictures=false logger=none "${how[@]}"
done

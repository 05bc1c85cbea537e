#!/usr/bin/env bash
# Runs with the settings by hand of each machine:  results/hardware/by_hand.sh SEEDS METHOD MACHINE...
# SETTINGS='trainer.max_epochs=2' in the environment adds settings to every run.
# These settings were chosen by rollout errors on its validation part, seed 0.
set -euo pipefail
seeds=$1 method=$2
shift 2
roots=(optimizer=levenberg_marquardt)

without() { # GROUPS SETTING...: the settings of other groups
  local groups=$1
  shift
  printf '%s\n' "$@" | grep -vE "^($groups)" || true
}

for machine in "$@"; do
  case $machine in
    free_single_pendulum) network=(integrator=galerkin4) ;;
    free_*) network=(integrator=galerkin4 dissipation.joints=neighbours) ;;
    motor_pendulum) network=(integrator=midpoint) ;;
    motor_double_pendulum)
      network=(integrator=midpoint net.width=2 net.depth=1 lagrangian.harmonics=1 dissipation=friction
        optimizer.starts=6) ;;
  esac
  own=("${network[@]}") wide=(net.width=32)
  if [ "$machine" = motor_double_pendulum ]; then
    own=(integrator=midpoint lagrangian=relative dissipation=friction)
    wide=(net.width=8 net.depth=1)
  fi
  explicit=(integrator=rk4)
  horizon=(objective=horizon trainer.validate_every=5 trainer.max_epochs=40 "${roots[@]}")
  if [ "$machine" = motor_pendulum ]; then horizon+=(dissipation=friction); fi
  case $method in
    symo) how=("${own[@]}") ;;
    symo-network) how=("${network[@]}") ;;
    symo-none) how=($(without dissipation "${network[@]}") dissipation=none) ;;
    symo-smoothed) how=("${network[@]}" 'optimizer.epsilons=[]') ;;
    e2e_symo-horizon) how=(model=e2e_symo "${own[@]}" "${horizon[@]}") ;;
    l_node-horizon) how=(model=l_node "${own[@]}" "${horizon[@]}" "${explicit[@]}") ;;
    l_node) how=(model=l_node "${network[@]}" "${explicit[@]}") ;;
    l_node-estimated) how=(model=l_node "${network[@]}" "${explicit[@]}" data.velocities=estimated) ;;
    node) how=(model=node "${wide[@]}" "${explicit[@]}") ;;
    node-estimated) how=(model=node "${wide[@]}" "${explicit[@]}" data.velocities=estimated) ;;
    e2e_symo) how=(model=e2e_symo $(without optimizer "${network[@]}") "${roots[@]}") ;;
    e2e_symo-none)
      how=(model=e2e_symo $(without 'dissipation|optimizer' "${network[@]}") "${roots[@]}" dissipation=none) ;;
  esac
  python -m symo_exp data=recorded system=recorded system.angular=all system.time_step=0.02 \
    preset=recorded data.path="recordings/$machine.parquet" reference="$machine" \
    experiment="hardware_$method" seed="$seeds" pictures=false logger=none "${how[@]}" ${SETTINGS:-}
done

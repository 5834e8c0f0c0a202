#!/bin/bash
# A run of any length in a SLURM queue, in jobs of half an hour:
#
#   sbatch slurm.sh
#
# Five minutes before its end SLURM sends USR2 to all ranks: the run writes a checkpoint and stops with exit code 75, and the job
# submits its successor. Any other exit code ends the chain. docs/batch.md tells more.
#SBATCH --job-name=two_disks
#SBATCH --ntasks=4
#SBATCH --cpus-per-task=2
#SBATCH --time=00:30:00
#SBATCH --signal=USR2@300
#SBATCH --open-mode=append
#SBATCH --output=two_disks.log

script=slurm.sh                # this file
scene=two_disks.nml
checkpoint=two_disks.checkpoint.h5 # NAME of &output, with .checkpoint.h5
program=gimp_mpi.x

export OMP_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}

# a job that SLURM itself started again (a lost node, a more important job) goes on where it was
if [ "${SLURM_RESTART_COUNT:-0}" -gt 0 ] && [ -e "$checkpoint" ]; then set -- --restart "$checkpoint"; fi

before=$(head -c 512 "$checkpoint" 2> /dev/null | cksum)
srun --input=0 "$program" "$@" < "$scene"
code=$?
[ $code -eq 75 ] || exit $code
if [ "$(head -c 512 "$checkpoint" | cksum)" = "$before" ]; then
  echo "$script: stopped before the first step; a longer --time is needed" >&2
  exit 1
fi
sbatch "$script" --restart "$checkpoint"

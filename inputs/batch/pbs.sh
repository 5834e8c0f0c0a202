#!/bin/bash
# A run of any length in a PBS queue, in jobs of half an hour:
#
#   qsub pbs.sh
#
# After 25 minutes `timeout` sends USR2 to mpirun, which hands it to all ranks: the run writes a checkpoint and stops with exit code
# 75, and the job submits its successor. Any other exit code ends the chain. docs/batch.md tells more.
#PBS -N two_disks
#PBS -l select=1:ncpus=8:mpiprocs=4:ompthreads=2
#PBS -l walltime=00:30:00
#PBS -j oe

script=pbs.sh                  # this file
scene=two_disks.nml
checkpoint=two_disks.checkpoint.h5 # NAME of &output, with .checkpoint.h5
program=gimp_mpi.x
minutes=25

cd "${PBS_O_WORKDIR:-.}" || exit 2
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}

before=$(head -c 512 "$checkpoint" 2> /dev/null | cksum)
timeout --preserve-status --signal=USR2 ${minutes}m mpirun "$program" ${GIMP_RESTART:+--restart "$GIMP_RESTART"} < "$scene"
code=$?
[ $code -eq 75 ] || exit $code
if [ "$(head -c 512 "$checkpoint" | cksum)" = "$before" ]; then
  echo "$script: stopped before the first step; more minutes are needed" >&2
  exit 1
fi
qsub -v GIMP_RESTART="$checkpoint" "$script"

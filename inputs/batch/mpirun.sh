#!/bin/bash
# A run of any length on a machine without a queue, in pieces that end with a checkpoint each:
#
#   ./mpirun.sh            starts it
#   ./mpirun.sh --restart two_disks.checkpoint.h5
#                          goes on, after the machine was down, say
#
# After `minutes` USR2 goes to mpirun, which hands it to all ranks: the run writes a checkpoint and stops with exit code 75, and this
# script begins the next piece. Any other exit code ends the chain. docs/batch.md tells more.

scene=two_disks.nml
checkpoint=two_disks.checkpoint.h5 # NAME of &output, with .checkpoint.h5
program=gimp_mpi.x
ranks=4
minutes=240

export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}

while true; do
  before=$(head -c 512 "$checkpoint" 2> /dev/null | cksum)
  timeout --preserve-status --foreground --signal=USR2 ${minutes}m mpirun -n $ranks \
    "$program" "$@" < "$scene"
  code=$?
  [ $code -eq 75 ] || exit $code
  if [ "$(head -c 512 "$checkpoint" | cksum)" = "$before" ]; then
    echo "$0: stopped before the first step; more minutes are needed" >&2
    exit 1
  fi
  set -- --restart "$checkpoint"
done

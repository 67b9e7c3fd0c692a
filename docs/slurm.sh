#!/usr/bin/env bash
# A data set as a SLURM job array, one shard a task: docs/offline.md says more.
#
#   sbatch docs/slurm.sh sim_config.yaml                  all shards; further options go to flatlight generate
#   flatlight status out/flying_things --shards 100       what is missing, as --array=3,7-9
#   sbatch --array=3,7-9 docs/slurm.sh sim_config.yaml    makes that
#
#SBATCH --job-name=flatlight
#SBATCH --array=0-99
#SBATCH --cpus-per-task=8
#SBATCH --mem-per-cpu=2G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail
shards=100 # of the data set, however few of them this array makes

# Instead of the shell, so that SLURM's signals reach it; in a container: exec apptainer exec flatlight.sif flatlight ...
exec flatlight generate "$@" --shard "$SLURM_ARRAY_TASK_ID/$shards" --set "dataset.workers=$SLURM_CPUS_PER_TASK"

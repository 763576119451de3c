#!/bin/bash
# The workflow on a real cluster engine: Slurm's own daemons, four nodes on this machine.
#   cluster_test.sh PROGRAM OUT [CAPTURES]
# Solves CAPTURES (40) small videos through workflow/Snakefile while one node and one job are killed,
# and the same by `sat-recon batch`; every model and splat must be equal byte for byte. Needs root,
# for Slurm's daemons.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
count=${3:-40}
root=$PWD
work=$out/slurm
rm -rf "$work" "$out/cluster" "$out/single" "$out/captures" "$out/.snakemake"
mkdir -p "$work/state" "$out/captures"
nodes=4
host=$(hostname -s)
# Jobs that the engine starts look for the configuration here alone.
config=/etc/slurm/slurm.conf
[ ! -e "$config" ] || { echo "$config exists: this machine is part of a cluster" >&2; exit 1; }

stop() {
    [ -z "${engine:-}" ] || kill "$engine" 2>/dev/null || true
    pkill -F "$work/slurmctld.pid" 2>/dev/null || true
    for n in $(seq $nodes); do pkill -F "$work/slurmd.node$n.pid" 2>/dev/null || true; done
    pkill -F "$work/munged.pid" 2>/dev/null || true
    [ "$(readlink "$config")" != "$work/slurm.conf" ] || rm "$config"
}
trap stop EXIT

munge_options=(--key-file="$work/key" --socket="$work/munge.socket" --pid-file="$work/munged.pid"
    --log-file="$work/munged.log" --seed-file="$work/munged.seed" --force)
head -c 1024 /dev/urandom > "$work/key"
chmod 600 "$work/key"
munged "${munge_options[@]}"
cat > "$work/slurm.conf" <<EOF
ClusterName=loopback
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=16817
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge.socket
CredType=cred/munge
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool.%n
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.%n.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
SlurmdTimeout=20
ReturnToService=2
MinJobAge=3600
JobRequeue=1
MpiDefault=none
NodeName=node[1-$nodes] NodeHostname=$host NodeAddr=127.0.0.1 Port=[17001-1700$nodes] CPUs=2 RealMemory=5000
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
EOF
mkdir -p "$(dirname "$config")"
ln -sfn "$work/slurm.conf" "$config"
slurmctld
for n in $(seq $nodes); do slurmd -N "node$n"; done
for _ in $(seq 30); do
    [ "$(sinfo -h -t idle -o %D)" = $nodes ] && break
    sleep 1
done
sinfo

for k in $(seq 0 $((count - 1))); do
    ffmpeg -y -loglevel error -i data/sample/orbit.mp4 -vf "trim=start_frame=$k,setpts=PTS-STARTPTS,scale=160:-2" \
        "$out/captures/clip_$(printf %02d "$k").mp4"
done
flags="--frames 12 --max-size 160 --iterations 20 --max-gaussians 1000"
# A name without blanks for the engine's own Python, wherever the tree lies.
[ -x "$out/venv/bin/snakemake" ] || {
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" -q install snakemake snakemake-executor-plugin-slurm
}
export PATH=$out/venv/bin:$PATH

run() {
    (cd "$out" && snakemake -q rules -s "$root/workflow/Snakefile" --executor slurm --slurm-status-command squeue \
        --slurm-init-seconds-before-status-checks 5 --seconds-between-status-checks 5 \
        --jobs 8 --retries 3 --latency-wait 30 --rerun-incomplete \
        --config captures="$out/captures" out="$out/cluster" program="$program" "flags=$flags" "$@")
}
begun=$SECONDS
run > "$work/snakemake.log" 2>&1 &
engine=$!
killed=
mkdir -p "$out/cluster/.jobs"
while kill -0 $engine 2>/dev/null; do
    sleep 2
    done_now=$(find "$out/cluster/.jobs" -name '*.report' 2>/dev/null | wc -l)
    if [ -z "$killed" ] && [ "$done_now" -ge 2 ]; then
        job=$(squeue -h -t R -w node1,node2,node3 -o %i | head -1)
        [ -n "$job" ] && scancel "$job" && echo "killed job $job after $done_now captures"
        # A node that loses power: its daemon and all that it runs.
        pkill -9 -F "$work/slurmd.node$nodes.pid"
        pkill -9 -f "slurmstepd.*node$nodes" || true
        scontrol update nodename=node$nodes state=down reason=killed
        echo "killed node$nodes"
        killed=yes
    fi
done
wait $engine || { tail -40 "$work/snakemake.log"; exit 1; }
echo "cluster: $count captures in $((SECONDS - begun)) s, one node and one job killed: ${killed:-no}"
[ -n "$killed" ]

begun=$SECONDS
code=0
# shellcheck disable=SC2086
"$program" batch "$out/captures" -o "$out/single" -q -- $flags || code=$?
echo "single machine: $count captures in $((SECONDS - begun)) s (exit code $code)"
differing=0
for folder in "$out"/single/clip_*/; do
    name=$(basename "$folder")
    for file in sparse/0/cameras.bin sparse/0/images.bin sparse/0/points3D.bin splat.ply; do
        one=$folder$file other=$out/cluster/$name/$file
        [ -e "$one" ] || [ -e "$other" ] || continue
        cmp -s "$one" "$other" || { echo "differs: $name/$file"; differing=$((differing + 1)); }
    done
done
echo "$(find "$out/cluster" -maxdepth 2 -name run.json | wc -l) of $count done, $differing files differ"
[ $differing = 0 ]

#!/usr/bin/env bash
# Builds the Dockerfile and reconstructs the sample video in it:
#   container.sh PROGRAM OUT
# With Docker or Podman the image itself. Where no engine runs, its last stage as a root file system
# in OUT/root by debootstrap (as root): RUN lines are executed in a chroot, COPY --from=build takes
# PROGRAM, the release binary, in place of what the first stage builds.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
command_line=(sfm sample.mp4 -o result --frames 24 --quality draft --quiet)
rm -rf "$out/work"
mkdir -p "$out/work"
cp data/sample/orbit.mp4 "$out/work/sample.mp4"

check() {
  ls -l "$out/work/result/sparse/0" "$out/work/result/run.json"
}

for engine in docker podman; do
  if "$engine" info >/dev/null 2>&1; then
    "$engine" build -t sat-recon .
    "$engine" run --rm -v "$out/work:/work" sat-recon "${command_line[@]}"
    check
    exit 0
  fi
done

echo "no container engine runs: the last stage of the Dockerfile in a chroot"
root="$out/root"
trap 'umount "$root/proc" 2>/dev/null || true' EXIT
if [ ! -e "$root/.made" ]; then
  rm -rf "$root"
  debootstrap --variant=minbase bookworm "$root" http://deb.debian.org/debian >"$out/debootstrap.log"
  touch "$root/.made"
fi
mount -t proc proc "$root/proc" 2>/dev/null || true
cp /etc/resolv.conf "$root/etc/resolv.conf"
[ ! -d /etc/apt/apt.conf.d ] || cp -r /etc/apt/apt.conf.d/. "$root/etc/apt/apt.conf.d/"
stage=$(awk '/^FROM /{text=""} {text=text $0 "\n"} END{printf "%s", text}' Dockerfile)
where=/
while read -r word rest; do
  case $word in
    RUN) chroot "$root" /bin/sh -c "export DEBIAN_FRONTEND=noninteractive; $rest" >>"$out/run.log" 2>&1 ;;
    COPY) install -D -m 755 "$program" "$root${rest##* }" ;;
    WORKDIR) where=$rest; mkdir -p "$root$where" ;;
    FROM | ENTRYPOINT | "") ;;
    *) echo "container.sh does not know $word" >&2; exit 1 ;;
  esac
done <<<"$stage"
strip "$root/usr/local/bin/sat-recon"
cp "$out/work/sample.mp4" "$root$where"
rm -rf "$root$where/result"
status=0
chroot "$root" /bin/sh -c "cd $where && exec sat-recon ${command_line[*]}" || status=$?
# 3: a small sample may be doubtful; what counts is that all of it runs.
[ "$status" -eq 0 ] || [ "$status" -eq 3 ]
cp -r "$root$where/result" "$out/work/"
check
du -sh --exclude=proc "$root"

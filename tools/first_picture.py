#!/usr/bin/env python3
"""How long it takes from nothing to the first picture, with the wheel, on a bare machine.

    first_picture.py WHEEL VIDEO --out FOLDER --results FOLDER [--python PREFIX]

Makes root file systems by debootstrap (as root): a bare Debian 12, and with --python one that is
like the image python:3.11, a CPython 3.11 from PREFIX in /usr/local with the libraries it needs.
Neither holds sat-recon, ffmpeg or numpy. In each, timed: Debian's packages (ffmpeg; on bare Debian
also Python), `pip install WHEEL`, and `sat-recon VIDEO` with the draft preset, until there is a
held-out view beside its render, the splat's page and the report. Making the file systems is not
timed. The figures are printed and kept in FOLDER, with the processor seconds used meanwhile by
these steps and by other work on the machine, which makes them longer; an error if one of the sums
is above the limit.
"""
import argparse
import glob
import os
import resource
import shutil
import subprocess
import sys
import time

from bench_results import Results

# What is asked for, seconds from nothing to the first picture.
LIMIT_S = 180.0
MIRROR = "http://deb.debian.org/debian"
# What CPython's own modules are linked with, as in the image.
LIBRARIES = (
    "ca-certificates libssl3 libffi8 zlib1g libbz2-1.0 liblzma5 libsqlite3-0 libreadline8 libuuid1"
)
# Beside what comes from a registry, settings of this machine's network.
SETTINGS = ["/etc/resolv.conf", "/etc/pip.conf", "/etc/apt/apt.conf.d"]
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"


class Root:
    """A root file system; commands run in it by chroot, with an environment of their own."""

    def __init__(self, place):
        self.place = place
        self.log = open(f"{place}.log", "w")

    def make(self):
        shutil.rmtree(self.place, ignore_errors=True)
        command = ["debootstrap", "--variant=minbase", "bookworm", self.place, MIRROR]
        subprocess.run(command, check=True, stdout=self.log, stderr=self.log)
        for path in filter(os.path.exists, SETTINGS):
            if os.path.isdir(path):
                shutil.copytree(path, self.place + path, dirs_exist_ok=True)
            else:
                shutil.copy(path, self.place + path)
        if os.path.exists(CERTIFICATES):
            shutil.copy(CERTIFICATES, self.place + "/etc/this-network.crt")

    def run(self, command):
        """Seconds that a shell command takes."""
        environment = {
            "PATH": "/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "LANG": "C.UTF-8",
            "DEBIAN_FRONTEND": "noninteractive", "PIP_ROOT_USER_ACTION": "ignore",
        }
        if os.path.exists(self.place + "/etc/this-network.crt"):
            environment["PIP_CERT"] = "/etc/this-network.crt"
        begin = time.monotonic()
        done = subprocess.run(["chroot", self.place, "/bin/sh", "-ec", command], env=environment,
                              stdout=self.log, stderr=subprocess.STDOUT)
        if done.returncode != 0:
            sys.exit(f"{command}: exit code {done.returncode}; see {self.place}.log")
        return time.monotonic() - begin


def bare(root):
    """Nothing but Debian's base: Python comes from its packages, too."""
    del root
    pip = "python3 -m venv /opt/sat-recon && /opt/sat-recon/bin/pip install"
    return "ffmpeg python3-venv", pip, "/opt/sat-recon/bin/"


def like_the_image(root, prefix):
    """A CPython in /usr/local without packages but pip."""
    root.run(f"apt-get update && apt-get install -y --no-install-recommends {LIBRARIES}")
    skipped = shutil.ignore_patterns("site-packages", "test", "__pycache__", "*.a")
    target = root.place + "/usr/local"
    shutil.copytree(f"{prefix}/lib/python3.11", f"{target}/lib/python3.11", symlinks=True, ignore=skipped)
    for library in glob.glob(f"{prefix}/lib/libpython3*.so*"):
        shutil.copy(library, f"{target}/lib", follow_symlinks=False)
    shutil.copy(f"{prefix}/bin/python3.11", f"{target}/bin/python3")
    root.run("ldconfig && python3 -m ensurepip")
    # As the image: no lists of packages.
    root.run("rm -rf /var/lib/apt/lists/*; apt-get clean")
    return "ffmpeg", "python3 -m pip install", "/usr/local/bin/"


def own_cpu_s():
    """Processor seconds of the steps so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def machine_cpu_s():
    """Processor seconds of everything on this machine: all columns but those of waiting."""
    with open("/proc/stat") as file:
        columns = [int(n) for n in file.readline().split()[1:9]]
    return (sum(columns) - columns[3] - columns[4]) / os.sysconf("SC_CLK_TCK")


def measure(root, name, wheel, video, ready):
    packages, pip, programs = ready
    install = f"apt-get update && apt-get install -y --no-install-recommends {packages}"
    begin = f"cd /root && {programs}sat-recon {os.path.basename(video)} -o out --quality draft"
    begun = own_cpu_s(), machine_cpu_s()
    assert not glob.glob(root.place + "/usr/**/*ffmpeg*", recursive=True), root.place
    for path in [wheel, video]:
        shutil.copy(path, root.place + "/root")
    row = {
        "system": name,
        "packages": packages,
        "packages_s": root.run(install),
        "wheel_s": root.run(f"{pip} /root/{os.path.basename(wheel)}"),
        "run_s": root.run(begin),
    }
    row["cpu_s"] = own_cpu_s() - begun[0]
    row["other_cpu_s"] = machine_cpu_s() - begun[1] - row["cpu_s"]
    row["total_s"] = row["packages_s"] + row["wheel_s"] + row["run_s"]
    made = root.place + "/root/out"
    pictures = sorted(glob.glob(made + "/eval/**/*.png", recursive=True))
    assert pictures, made
    for name in ["view.html", "report.html", "splat.ply"]:
        assert os.path.getsize(f"{made}/{name}") > 0, name
    shutil.copy(pictures[0], f"{root.place}.png")
    return row


def main():
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("wheel")
    parser.add_argument("video")
    parser.add_argument("--out", required=True)
    parser.add_argument("--results", required=True)
    parser.add_argument("--python", metavar="PREFIX")
    args = parser.parse_args()
    os.makedirs(args.out, exist_ok=True)
    kinds = {"Debian 12, bare": bare}
    if args.python:
        kinds["like `python:3.11`"] = lambda root: like_the_image(root, args.python)
    rows = []
    table = Results(args.results).table("first_picture")
    for number, (name, ready) in enumerate(kinds.items()):
        root = Root(os.path.join(os.path.realpath(args.out), f"root{number}"))
        root.make()
        proc = os.path.join(root.place, "proc")
        subprocess.run(["mount", "-t", "proc", "proc", proc], check=False)
        try:
            row = measure(root, name, args.wheel, args.video, ready(root))
        finally:
            subprocess.run(["umount", proc], check=False)
        table.row(row)
        rows.append(row)
        shutil.rmtree(root.place)
    if any(row["total_s"] > LIMIT_S for row in rows):
        sys.exit(f"more than {LIMIT_S:.0f} s")


if __name__ == "__main__":
    main()

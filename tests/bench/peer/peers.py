#!/usr/bin/env python3
"""Runs the peers' harness with FIONA among the peers, until enough runs of each kind were undisturbed, and prints the table.

usage: peers.py HARNESS BUILD MORE RESULT [--reps N] [--rounds N] [--share S] [-- ARGUMENTS OF run.py]

HARNESS is the harness' folder, BUILD where it is built, MORE the list of peers that it does not know itself. A run counts
when others had at most --share of the processors meanwhile; before each run a quiet moment is waited for, and rounds
are repeated, at most --rounds of them, until each kind of run counts --reps times. RESULT gets the runs that count.
"""
import argparse
import collections
import importlib.util
import json
import os
import resource
import subprocess
import sys
import tempfile
import time

TICK = os.sysconf("SC_CLK_TCK")
QUIET_S = 15  # how long a quiet moment is waited for


def machine():
    """Ticks of the processors: busy, stolen, all."""
    with open("/proc/stat") as file:
        user, nice, system, idle, iowait, irq, softirq, steal = map(int, file.readline().split()[1:9])
    busy = user + nice + system + irq + softirq
    return busy, steal, busy + steal + idle + iowait


def own_ticks():
    """What this process and all that it has started have used; those that live still, among them daemons, too."""
    used = 0.0
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        usage = resource.getrusage(who)
        used += (usage.ru_utime + usage.ru_stime) * TICK
    children = collections.defaultdict(list)
    ticks = {}
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{entry}/stat") as file:
                fields = file.read().rsplit(")", 1)[1].split()
        except OSError:
            continue
        children[int(fields[1])].append(int(entry))
        ticks[int(entry)] = sum(map(int, fields[11:15]))
    left = list(children[os.getpid()])
    while left:
        one = left.pop()
        used += ticks[one]
        left += children[one]
    return used


def await_quiet(share):
    end = time.monotonic() + QUIET_S
    while time.monotonic() < end:
        busy, _, total = machine()
        time.sleep(0.2)
        busy_after, _, total_after = machine()
        if (busy_after - busy) <= share * (total_after - total):
            return


class Harness:
    """run.py, told what others use by what was measured, where it goes by what is niced."""

    def __init__(self, folder, share):
        spec = importlib.util.spec_from_file_location("run", os.path.join(folder, "run.py"))
        self.run = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.run)
        self.run.cpu_times = self.cpu_times
        self.share = share
        self.in_run = False

    def cpu_times(self):
        """Called before and after each run."""
        self.in_run = not self.in_run
        if self.in_run:
            await_quiet(self.share)
        busy, stolen, total = machine()
        return max(busy - own_ticks(), 0), stolen, total

    def round(self, arguments):
        sys.argv = ["run.py", *arguments]
        self.run.main()


def kind(result):
    return tuple(result.get(key) for key in ("peer", "transport", "procs", "scenario", "size")) + (result.get("subs", 1),)


def read(path):
    with open(path) as file:
        return [json.loads(line) for line in file]


def main():
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("harness")
    parser.add_argument("build")
    parser.add_argument("more")
    parser.add_argument("result")
    parser.add_argument("--reps", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=0)
    parser.add_argument("--share", type=float, default=0.05)
    own, rest = parser.parse_known_args()
    rest = [one for one in rest if one != "--"]
    harness = Harness(own.harness, own.share)
    counted = collections.defaultdict(list)
    runs = 0
    for _ in range(own.rounds or 3 * own.reps):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "round.jsonl")
            harness.round([own.build, path, "--reps", "1", "--more", own.more, *rest])
            for result in read(path):
                runs += 1
                all_of_kind = counted[kind(result)]
                if result["foreign_share"] <= own.share and len(all_of_kind) < own.reps:
                    all_of_kind.append(result)
        if all(len(results) >= own.reps for results in counted.values()):
            break
    with open(own.result, "w") as file:
        for results in counted.values():
            for result in results:
                file.write(json.dumps(result) + "\n")
    subprocess.run([sys.executable, os.path.join(own.harness, "table.py"), own.result], check=True)
    kept = sum(map(len, counted.values()))
    short = sorted(" ".join(map(str, one)) for one, results in counted.items() if len(results) < own.reps)
    print(f"\n{kept} of {runs} runs count; in the others something else had more than {own.share:.0%} of the processors.")
    for one in short:
        print(f"too few undisturbed runs: {one}")
    failed = sorted({" ".join(map(str, one)) for one, results in counted.items() for r in results if r.get("failed")})
    for one in failed:
        print(f"failed: {one}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

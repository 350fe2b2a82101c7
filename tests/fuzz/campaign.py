#!/usr/bin/env python3
"""Runs fuzz targets under libFuzzer until each has had its seconds of processor time, over as many runs as that takes.

    campaign.py BUILD SECONDS [TARGET …]

BUILD is a build of the preset `fuzz`. BUILD/found keeps what was found: TARGET/ the new inputs, TARGET.json the seconds
and inputs so far, TARGET-crash-… and the like what ended a target.
"""
import json
import pathlib
import re
import resource
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SLICE_S = 300
# What is promised is 1 s and 256 MiB without sanitizers: with them an input takes several times as long, and their shadow,
# what they keep of what was freed, and the fuzzer's own corpus need memory.
LONGEST_S = 10
MOST_MIB = 512
TIMED_OUT = 70
# A run of a whole system touches so much that weighing what is rare in it takes longer than the run.
OPTIONS = {"console_line": ["-entropic=0"], "wiring": ["-entropic=0"]}


def processor_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def last_number(pattern, log, otherwise=0):
    found = re.findall(pattern, log)
    return int(found[-1]) if found else otherwise


class Target:
    def __init__(self, build, name, found):
        self.name, self.program, self.found = name, build / "bin" / f"{name}_fuzz", found
        self.state = self.found / f"{name}.json"
        self.told = {"seconds": 0.0, "inputs": 0, "edges": 0, "mib": 0}
        if self.state.exists():
            self.told |= json.loads(self.state.read_text())

    def run(self, *arguments):
        """Gives the exit status, what was said, and the processor time."""
        before = processor_s()
        dictionary = HERE / "dictionaries" / f"{self.name}.dict"
        done = subprocess.run([self.program, f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MIB}",
                               *OPTIONS.get(self.name, []),
                               *([f"-dict={dictionary}"] if dictionary.exists() else []), *arguments],
                              capture_output=True, text=True, errors="replace",
                              env={"ASAN_OPTIONS": "quarantine_size_mb=16"})
        return done.returncode, done.stderr, processor_s() - before

    def slice(self, seconds):
        """Fuzzes for some time; gives what was said if that was ended by a finding."""
        new = self.found / self.name
        new.mkdir(parents=True, exist_ok=True)
        status, log, used = self.run(f"-max_total_time={seconds}", "-print_final_stats=1",
                                     f"-artifact_prefix={new}-", new, HERE / "corpus" / self.name)
        self.told["seconds"] += used
        self.told["inputs"] += last_number(r"number_of_executed_units: *(\d+)", log)
        self.told["edges"] = last_number(r" cov: (\d+)", log, self.told["edges"])
        self.told["mib"] = max(self.told["mib"], last_number(r"peak_rss_mb: *(\d+)", log))
        self.state.write_text(json.dumps(self.told))
        return None if status == 0 or (status == TIMED_OUT and not self.is_slow(log)) else log

    def is_slow(self, log):
        """libFuzzer's clock goes on while the machine does something else: what counts is processor time."""
        slow = re.findall(r"Test unit written to (.*)", log)[-1]
        used = self.run(slow)[2]
        if used < LONGEST_S:
            pathlib.Path(slow).unlink()
        return used >= LONGEST_S

    def campaign(self, seconds):
        """Whether nothing was found."""
        while (left := seconds - self.told["seconds"]) > 0:
            if log := self.slice(max(1, min(SLICE_S, round(left)))):
                print("\n".join(log.splitlines()[-40:]))
                return False
        print("{name}: {seconds:.0f} s of processor time, {inputs} inputs, {edges} edges reached, {mib} MiB at most, "
              "no finding".format(name=self.name, **self.told), flush=True)
        return True


def finds_the_failure(build):
    """Whether a failure that is there to be found is found: by who begins anew, and has kept nothing that takes long."""
    with tempfile.TemporaryDirectory() as found:
        return Target(build, "seeded_failure", pathlib.Path(found)).slice(60) is not None


def main():
    build, seconds = pathlib.Path(sys.argv[1]), int(sys.argv[2])
    known = sorted(program.name.removesuffix("_fuzz") for program in (build / "bin").glob("*_fuzz"))
    for target in set(sys.argv[3:]) - set(known):
        sys.exit(f"there is no fuzz target {target}: {', '.join(known)}")
    if not finds_the_failure(build):
        sys.exit("the fuzzer has not found the failure that is there to be found")
    targets = sys.argv[3:] or [target for target in known if target != "seeded_failure"]
    sys.exit(0 if all([Target(build, target, build / "found").campaign(seconds) for target in targets]) else 1)


main()

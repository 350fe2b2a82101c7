#!/usr/bin/env python3
"""Counts the lines of each fuzz target's parser that its inputs reach, and says which are not reached.

    coverage.py BUILD FOUND [TARGET …]

BUILD is a build of the preset `coverage`; inputs are those in corpus/TARGET and, if there are any, FOUND/TARGET.
"""
import os
import pathlib
import re
import subprocess
import sys
import tempfile

LEAST_PERCENT = 90
ROOT = pathlib.Path(__file__).resolve().parents[2]
TOOLS = "14"


def mangled(name):
    """As a pattern: the identifiers of A::b, A::A, A::~A within a mangled name (C++ ABI for Itanium, 5.1)."""
    pattern, before = r"(?:(?<!\d)|(?<=_GLOBAL__N_1))", None
    for part in name.split("::"):
        special = {before: "C[1-5]", f"~{before}": "D[0-5]"}
        pattern, before = pattern + special.get(part, f"{len(part)}{part}"), part
    return pattern


def names_in(function, names):
    """Those of `names` that a mangled name is of, or within."""
    return {name for name in names if re.search(mangled(name), function)}


class Source:
    """What llvm-cov tells of one source: each line's count, and which function begins where."""

    def __init__(self):
        self.counts, self.functions = {}, []

    def counted(self, beside, seen):
        """The lines that are in no function of `beside`; what of it there is goes into `seen`."""
        kept, functions = {}, sorted(self.functions)
        for line, count in sorted(self.counts.items()):
            inside = [name for begin, name in functions if begin <= line][-1]
            others = names_in(inside, beside)
            seen |= others
            if not others:
                kept[line] = count
        return kept


def read_lcov(text):
    sources = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        if key == "SF":
            source = sources.setdefault(os.path.relpath(value, ROOT), Source())
        elif key == "FN":
            begin, name = value.split(",", 1)
            source.functions.append((int(begin), name.rpartition(":")[2]))
        elif key == "DA":
            number, count = (int(part) for part in value.split(",")[:2])
            source.counts[number] = max(count, source.counts.get(number, 0))
    return sources


def run(build, target, inputs):
    """Replays the inputs; gives what llvm-cov tells of our sources."""
    program = build / "bin" / f"{target}_replay"
    with tempfile.TemporaryDirectory() as scratch:
        replayed = subprocess.run([program, "0", *inputs], capture_output=True, text=True,
                                  env={"LLVM_PROFILE_FILE": f"{scratch}/%p.profraw", "TMPDIR": scratch})
        if replayed.returncode != 0:
            sys.exit(f"{target}: {replayed.stderr}")
        profile = f"{scratch}/profile"
        subprocess.run([f"llvm-profdata-{TOOLS}", "merge", "-o", profile, *pathlib.Path(scratch).glob("*.profraw")],
                       check=True)
        # Not by their names: it does not find one that the compiler was told of relative to the build.
        told = subprocess.run([f"llvm-cov-{TOOLS}", "export", "-format=lcov", f"-instr-profile={profile}", program,
                               f"-object={build / 'lib/libfiona.so'}", "-ignore-filename-regex=^/usr/|/generated/"],
                              capture_output=True, text=True, check=True)
    return read_lcov(told.stdout)


def ranges(lines):
    texts, begin = [], None
    for line in lines:
        begin = line if begin is None else begin
        if line + 1 not in lines:
            texts.append(str(line) if begin == line else f"{begin}-{line}")
            begin = None
    return " ".join(texts)


def measure(build, found, target):
    """Prints what the target reaches; whether that is enough."""
    files, beside = (line.split(";") for line in
                     (build / "tests/fuzz" / f"{target}.parser").read_text().splitlines())
    beside, seen = set(filter(None, beside)), set()
    inputs = [folder for folder in (ROOT / "tests/fuzz/corpus" / target, found / target) if folder.is_dir()]
    sources = run(build, target, inputs)
    lines = {file: sources[file].counted(beside, seen) if file in sources else {} for file in files}
    for stale in [file for file in files if not lines[file]] + sorted(beside - seen):
        sys.exit(f"{target}: {stale} is not in its program: correct tests/fuzz/CMakeLists.txt")
    total = sum(map(len, lines.values()))
    reached = sum(count > 0 for counts in lines.values() for count in counts.values())
    percent = 100 * reached / total
    enough = percent >= LEAST_PERCENT
    print(f"{target}: {reached} of {total} lines, {percent:.1f} %{'' if enough else ', SHORT'}", flush=True)
    for file, counts in lines.items():
        if missing := [line for line, count in sorted(counts.items()) if count == 0]:
            print(f"    {file}: {ranges(missing)}")
    return enough


def main():
    build, found = (pathlib.Path(argument) for argument in sys.argv[1:3])
    known = sorted(file.stem for file in (build / "tests/fuzz").glob("*.parser"))
    targets = sys.argv[3:] or [target for target in known if target != "seeded_failure"]
    for target in set(targets) - set(known):
        sys.exit(f"there is no fuzz target {target}: {', '.join(known)}")
    enough = [measure(build, found, target) for target in targets]
    sys.exit(0 if all(enough) else 1)


main()

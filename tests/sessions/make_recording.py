#!/usr/bin/env python3
"""Writes a small recording in the layout of the Indoor Location Competition 2.0: make_recording.py DIR

One floor with a corridor of 40 m, eight access points, four survey walks and one test walk with inertial rows, all
computed: log-distance propagation without noise, a gait of two steps a second, the phone pointing east.
"""
import io
import lzma
import math
import sys
import tarfile
from pathlib import Path

ACCESS_POINTS = [(f"0a00000000{i:02x}", 5.0 * i, 3.0 if i % 2 else -3.0) for i in range(9)]


def scan(t_ms, x, y):
    for bssid, ax, ay in ACCESS_POINTS:
        rssi = -38 - 28 * math.log10(max(1.0, math.hypot(x - ax, y - ay)))
        yield f"W\t{t_ms}\t{bssid}\t{rssi:.0f}\t2437\t{t_ms}"


def survey(name, start, end, duration_s):
    rows = [f"# trace={name} start_ms=1570000000000 floor=0 floor_name=F1"]
    for t in range(0, duration_s + 1):
        x = start + (end - start) * t / duration_s
        if t % 5 == 0:
            rows.append(f"P\t{1000 * t}\t{x:.3f}\t0.000")
        rows.extend(scan(1000 * t, x, 0.0))
    return rows


def test_walk(name, start, speed_mps, duration_s):
    rows = [f"# trace={name} start_ms=1570000000000"]
    for i in range(50 * duration_s):
        t_ms = 20 * i
        swing = 2.5 * math.sin(2 * math.pi * 2.0 * t_ms / 1000)
        rows += [f"A\t{t_ms}\t0\t0\t{9.81 + swing:.4g}", f"G\t{t_ms}\t0\t0\t0", f"M\t{t_ms}\t-20\t0\t-42"]
        if t_ms % 1000 == 0:
            rows.extend(scan(t_ms, start + speed_mps * t_ms / 1000, 0.0))
    return rows


def write(archive, folder, walks):
    archive.parent.mkdir(parents=True, exist_ok=True)
    with lzma.open(archive, "wb") as packed, tarfile.open(fileobj=packed, mode="w") as tar:
        for name, rows in walks.items():
            text = ("\n".join(rows) + "\n").encode()
            entry = tarfile.TarInfo(f"{folder}/{name}.tsv")
            entry.size = len(text)
            tar.addfile(entry, io.BytesIO(text))


def main():
    out = Path(sys.argv[1])
    walks = {f"survey{i}": survey(f"survey{i}", *ends, 40) for i, ends in enumerate([(0, 40), (40, 0)] * 2)}
    write(out / "F1/train.tar.xz", "train", walks)
    write(out / "test.tar.xz", "test", {"walk1": test_walk("walk1", 5.0, 1.0, 30)})
    truth = [f"walk1,{1000 * t},{5 + t},0,0" for t in range(5, 30, 5)]
    (out / "test_truth.csv").write_text("trace,t_ms,x,y,floor\n" + "\n".join(truth) + "\n")
    (out / "traces.csv").write_text("trace,split\nwalk1,test\n")


if __name__ == "__main__":
    main()

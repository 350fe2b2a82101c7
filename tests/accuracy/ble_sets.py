#!/usr/bin/env python3
"""Brings two published sets of Bluetooth readings into the rows of fiona-beaconmap and evaluate-beacons.

  ble_sets.py uji_ble_library|ble_tetam DIR OUT     writes OUT/survey.csv, OUT/tracks.csv, OUT/truth.csv

uji_ble_library: each survey or query row is a second of its own; the phone, of three, is the walk.
ble_tetam: fixed sensors hear a beacon that is carried about: the sensors are the beacons here. Of each histogram of the
survey sixteen quantiles are taken, one a second; a track's rows keep their times, and each is a way-point.
"""
import csv
import gzip
import json
import pathlib
import random
import sys


def rows_of(file):
    with (gzip.open(file, "rt") if file.suffix == ".gz" else open(file, newline="")) as handle:
        yield from csv.DictReader(handle)


def writer(out, name, columns):
    handle = open(out / name, "w", newline="")
    result = csv.writer(handle, lineterminator="\n")
    result.writerow(columns)
    return result


SURVEY = ("walk", "second", "x", "y", "level", "beacon", "rssi_dbm")
TRACKS = ("track", "t_ms", "beacon", "rssi_dbm")
TRUTH = ("trace", "t_ms", "x", "y", "floor")


def uji(data, out):
    survey, tracks, truth = writer(out, "survey.csv", SURVEY), writer(out, "tracks.csv", TRACKS), writer(out, "truth.csv", TRUTH)
    for second, row in enumerate(rows_of(data / "train.csv.gz")):
        heard = [(k, v) for k, v in row.items() if k[0] == "b" and v]
        for beacon, rssi in heard or [("", "0")]:
            survey.writerow((row["ids_code"][0], second, row["x"], row["y"], 0, beacon, rssi))
    places = {row["id"]: (row["x"], row["y"]) for row in rows_of(data / "truth.csv")}
    for row in rows_of(data / "queries.csv.gz"):
        for beacon, rssi in ((k, v) for k, v in row.items() if k[0] == "b" and v):
            tracks.writerow((row["id"], 0, beacon, rssi))
        # A first fix takes a second, and one scan is all that there is.
        truth.writerow((row["id"], 1000, *places[row["id"]], 0))


def quantiles(levels, histogram, count=16):
    total, reached, wanted = sum(histogram), 0.0, 0
    for level, share in zip(levels, histogram):
        reached += share / total
        while wanted < count and reached >= (wanted + 0.5) / count - 1e-9:
            yield level
            wanted += 1


def tetam(data, out):
    survey, tracks, truth = writer(out, "survey.csv", SURVEY), writer(out, "tracks.csv", TRACKS), writer(out, "truth.csv", TRUTH)
    lines = gzip.open(data / "set1_histograms.hst.gz", "rt").read().split("\n")
    bins = json.loads(lines[0].split(":", 1)[1])
    for number, (place, sensors) in enumerate(json.loads(lines[3].split(":", 1)[1]).items()):
        x, y, _ = place.strip("()").split(",")
        for sensor, beacons in sensors.items():
            for histogram in beacons.values():
                values = list(quantiles(bins, histogram)) if sum(histogram) else []
                # The sensors' readings of a second are not all their lowest or all their highest.
                random.Random("%s %s %d" % (place, sensor, sum(histogram))).shuffle(values)
                for second, rssi in enumerate(values):
                    survey.writerow(("survey", 16 * number + second, x.strip(), y.strip(), 0, sensor, rssi))
    for file in sorted(data.glob("track_*.csv.gz")):
        track, begin = file.name.removesuffix(".csv.gz"), None
        for row in rows_of(file):
            begin = begin or float(row["t_s"])
            t_ms = round(1000 * (float(row["t_s"]) - begin))
            tracks.writerow((track, t_ms, row["sensor"], row["rssi_dbm"]))
            truth.writerow((track, t_ms, row["x"], row["y"], 0))


def main():
    if len(sys.argv) != 4 or sys.argv[1] not in ("uji_ble_library", "ble_tetam"):
        sys.exit(__doc__)
    out = pathlib.Path(sys.argv[3])
    out.mkdir(parents=True, exist_ok=True)
    (uji if sys.argv[1] == "uji_ble_library" else tetam)(pathlib.Path(sys.argv[2]), out)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Runs incise over test files and compares what it says with what is right.

    check.py PROGRAM FOLDER... [--json] [--kind TEXT] [--name TEXT] [-v] [-j N]

Every FOLDER holds a `cases.json`: a list of cases, made by the `make_*.py` beside this file. A case
has a `kind`, a `name`, a `path` below the folder, `options` of the reader, the `peer` that says what
is right, and what must come out, each optional:

    volume     size, components, spacing_mm, origin_mm, direction, modality, time_points, series,
               labels, description, count (of voxels, by label): as `incise info --json` shows them
               values [[i, j, k, value], ...]: `incise bake`
               colors [[i, j, k, [r, g, b]], ...]: `incise bake --channel 1..3`
    mesh       triangles, vertices, volume_mm3: `incise info --json`
               sdf [[x, y, z, mm], ...]: `incise sdf`, positive inside
    transform  points [[x, y, z, X, Y, Z], ...], from the deformed point to its source: `incise map`
    any        warns, not_warns: fragments of warnings; error: fragments of the one message of a
               refusal; several forms in a list stand for any of them
               either: a list of such expectations, of which one is enough

A field that the command line cannot show is counted as not checked. Needs numpy and pynrrd.
Exits with 1 if anything is wrong.
"""

import argparse
import concurrent.futures
import json
import math
import os
import subprocess
import sys
import tempfile
import unicodedata

import nrrd
import numpy as np

# What describes a case, rather than what must come out.
ABOUT = {"kind", "name", "path", "options", "peer", "note", "tolerance"}
# Options of a case, and the option of the program.
OPTIONS = {
    "time": "--time",
    "series": "--series",
    "channel": "--channel",
    "level": "--resolution",
    "spacing": "--spacing",
    "raw": "--raw",
    "resample": "--resample",
}
# Options of a transform.
MAP_OPTIONS = {"volume": "--volume", "convention": "--convention", "invert": "--invert"}
TRANSFORMS = (".mat", ".tfm", ".lta", ".1d", ".afni", ".fsl", ".xfm", ".h5", ".txt", ".x5")
# The grid on which the signed distance of a point is sampled, as a share of the mesh.
CELL = 1 / 2000
TIMEOUT_S = 120


class Run:
    """One run of the program."""

    def __init__(self, *command):
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=TIMEOUT_S, stdin=subprocess.DEVNULL
            )
            self.code = done.returncode
            self.out = done.stdout.decode("utf-8", "replace")
            self.err = done.stderr.decode("utf-8", "replace")
        except subprocess.TimeoutExpired:
            self.code, self.out, self.err = -1, "", f"more than {TIMEOUT_S} seconds"

    def problem(self):
        return f"exit code {self.code}: {self.err.strip()[-300:]}"


def near(found, expected, relative, absolute):
    if expected is None or (isinstance(expected, float) and math.isnan(expected)):
        return found is None or math.isnan(found)
    return found is not None and abs(found - expected) <= absolute + relative * abs(expected)


def all_near(found, expected, relative, absolute):
    found, expected = np.asarray(found, float).ravel(), np.asarray(expected, float).ravel()
    return found.shape == expected.shape and all(
        near(float(f), float(e), relative, absolute) for f, e in zip(found, expected)
    )


def holds(text, fragments):
    """Whether a text holds a fragment, or one of several, in any case."""
    fragments = [fragments] if isinstance(fragments, str) else fragments
    return any(f.lower() in text.lower() for f in fragments)


def series_count(report):
    if "all_series" in report:
        return len(report["all_series"])
    return report.get("series", {}).get("of", 1)


def labels_differ(found, expected):
    found = found or {}
    wrong = [k for k, name in expected.items() if found.get(str(k)) != name]
    return [f"label {k} is {found.get(str(k))!r}, not {expected[k]!r}" for k in wrong]


class Case:
    """One case, and what is wrong with it."""

    def __init__(self, program, folder, case):
        self.program, self.folder, self.case = program, folder, case
        self.path = os.path.join(folder, case["path"])
        self.wrong, self.not_checked = [], []
        self.left = {name for name in case if name not in ABOUT}

    def take(self, name):
        self.left.discard(name)
        return self.case.get(name)

    def options(self, names):
        out = []
        for name, value in self.case.get("options", {}).items():
            if name not in names:
                continue
            if value is True:
                out.append(names[name])
            elif isinstance(value, list):
                out += [names[name], ",".join(str(v) for v in value)]
            elif name == "volume":
                out += [names[name], os.path.join(self.folder, value)]
            else:
                out += [names[name], str(value)]
        return out

    def run(self, scratch):
        named = self.path.lower().endswith(TRANSFORMS) and "size" not in self.case
        if "points" in self.case or named:
            self.check_transform(scratch)
        else:
            self.check_image(scratch)
        for name in sorted(self.left):
            self.not_checked.append(name)
        return self

    def expect(self, name, found, right):
        expected = self.take(name)
        if expected is not None and not right(found, expected):
            self.wrong.append(f"{name} is {found}, not {expected}")

    # Images and meshes.

    def check_image(self, scratch):
        command = [self.program, "info", "--json", *self.options(OPTIONS), self.path]
        info = Run(*command)
        if self.refused(info):
            return
        try:
            report = json.loads(info.out)
        except ValueError:
            self.wrong.append(f"info printed no JSON: {info.out[:200]!r}")
            return
        exact = lambda found, expected: found == expected
        length = lambda found, expected: found is not None and all_near(found, expected, 1e-4, 1e-12)
        place = lambda found, expected: found is not None and all_near(found, expected, 1e-6, 2e-4)
        for name in ("size", "components", "modality", "triangles", "vertices", "inverted"):
            self.expect(name, report.get(name), exact)
        self.expect("spacing_mm", report.get("spacing_mm"), length)
        self.expect("origin_mm", report.get("origin_mm"), place)
        self.expect("direction", report.get("direction"), place)
        self.expect("time_points", report.get("time_points", 1), exact)
        self.expect("series", series_count(report), exact)
        self.expect("description", report.get("series", {}).get("description"), exact)
        self.expect("count", report.get("label_voxels"), lambda f, e: f is not None and e.items() <= f.items())
        self.expect("volume_mm3", report.get("volume_mm3"), lambda f, e: near(f, e, 1e-4, 1e-6))
        self.wrong += labels_differ(report.get("label_names"), self.take("labels") or {})
        self.check_warnings(report.get("warnings", []))
        self.check_characters(report)
        self.check_values(scratch)
        self.check_distances(scratch, max(report.get("extent_mm") or [1.0]))

    def refused(self, run):
        """Whether there is nothing more to check because the file was refused, or should be."""
        expected = self.take("error")
        if run.code not in (0, 1):
            self.wrong.append(run.problem())
        elif expected is None and run.code == 1:
            self.wrong.append(f"refused: {run.err.strip()[-300:]}")
        elif expected is not None and run.code == 0:
            self.wrong.append(f"opened, not refused with {expected}")
        elif expected is not None:
            lines = [line for line in run.err.splitlines() if line.strip()]
            if not any(all(holds(line, e) for e in expected) for line in lines[-1:]):
                self.wrong.append(f"refused with {run.err.strip()!r}, not with {expected}")
        else:
            return False
        self.left.clear()
        return True

    def check_characters(self, report):
        """No text of a file may reach the terminal with control characters."""
        texts = [report.get("series", {}).get("description") or ""]
        texts += (report.get("label_names") or {}).values()
        for text in texts:
            if any(unicodedata.category(c) == "Cc" for c in text):
                self.wrong.append(f"control characters in {text!r}")

    def check_warnings(self, warnings):
        for fragment in self.take("warns") or []:
            if not any(holds(w, fragment) for w in warnings):
                self.wrong.append(f"no warning says {fragment!r}: {warnings}")
        for fragment in self.take("not_warns") or []:
            for w in warnings:
                if holds(w, fragment):
                    self.wrong.append(f"a warning says {fragment!r}: {w}")

    def baked(self, scratch, channel=None):
        """The voxels as written by bake, indexed [i, j, k]."""
        out = os.path.join(scratch, "out.nrrd")
        options = self.options(OPTIONS) + (["--channel", str(channel)] if channel else [])
        run = Run(
            self.program, "bake", self.path, "-o", out, "--interpolation", "nearest", "-q", *options
        )
        if run.code != 0:
            self.wrong.append(f"bake: {run.problem()}")
            return None
        voxels = nrrd.read(out, index_order="F")[0]
        os.remove(out)
        return voxels

    def check_values(self, scratch):
        values, colors = self.take("values"), self.take("colors")
        tolerance = self.case.get("tolerance")
        if values:
            voxels = self.baked(scratch)
            if voxels is not None:
                for *at, value in values:
                    found = self.voxel(voxels, at)
                    if not near(found, value, 1e-5, tolerance or 1e-3):
                        self.wrong.append(f"value at {at} is {found}, not {value}")
        if colors:
            channels = [self.baked(scratch, c) for c in (1, 2, 3)]
            if all(c is not None for c in channels):
                for i, j, k, color in colors:
                    found = [self.voxel(c, [i, j, k]) for c in channels]
                    if None in found or not all_near(found, color, 0, tolerance or 0.5):
                        self.wrong.append(f"colour at {[i, j, k]} is {found}, not {color}")

    @staticmethod
    def voxel(voxels, at):
        inside = voxels.ndim == 3 and all(0 <= a < n for a, n in zip(at, voxels.shape))
        return float(voxels[tuple(at)]) if inside else None

    def check_distances(self, scratch, extent_mm):
        cell = CELL * extent_mm
        for *point, expected in self.take("sdf") or []:
            out = os.path.join(scratch, "sdf.nrrd")
            corners = [p - 2 * cell for p in point] + [p + 2 * cell for p in point]
            box = ",".join(f"{c:.9f}" for c in corners)
            options = ["-q", "--exact", "--box", box, "--cell", f"{cell:.9f}"]
            run = Run(self.program, "sdf", self.path, "-o", out, *options)
            if run.code != 0:
                self.wrong.append(f"sdf: {run.problem()}")
                return
            found = sampled(*nrrd.read(out, index_order="F"), point)
            os.remove(out)
            if not near(found, expected, 1e-3, self.case.get("tolerance") or 2e-3):
                self.wrong.append(f"signed distance at {point} is {found}, not {expected}")

    # Transforms.

    def check_transform(self, scratch):
        out = os.path.join(scratch, "field.nrrd")
        run = Run(self.program, "map", self.path, "-o", out, *self.options(MAP_OPTIONS))
        if self.refused(run):
            return
        self.check_warnings([line for line in run.err.splitlines() if line.strip()])
        voxels, header = nrrd.read(out, index_order="F")
        os.remove(out)
        for numbers in self.take("points") or []:
            flat = np.asarray(numbers, float).ravel()
            point, expected = flat[:3], flat[3:6]
            moved = [sampled(voxels[a], header, point, vector=True) for a in range(3)]
            found = None if None in moved else [float(p + m) for p, m in zip(point, moved)]
            if found is None:
                self.not_checked.append("points")
            elif not all_near(found, expected, 1e-4, self.case.get("tolerance") or 5e-3):
                self.wrong.append(f"{point.tolist()} comes from {found}, not {expected.tolist()}")


def sampled(voxels, header, point, vector=False):
    """The value at a point by linear interpolation in a file's grid, None outside it."""
    axes = np.asarray(header["space directions"], float)
    axes = axes[~np.isnan(axes).any(axis=1)]
    world_from_voxel = axes.T
    at = np.linalg.solve(world_from_voxel, np.asarray(point, float) - header["space origin"])
    if vector and voxels.ndim != 3:
        return None
    low = np.clip(np.floor(at).astype(int), 0, np.maximum(np.array(voxels.shape) - 2, 0))
    share = at - low
    if (share < -1e-3).any() or (share > 1 + 1e-3).any():
        return None
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([s if c else 1 - s for c, s in zip(corner, share)])
        if weight != 0:
            total += weight * float(voxels[tuple(low + corner)])
    return total


def check(program, folder, case):
    """The case checked; of several expectations, with the first that holds, else the first."""
    common = {name: value for name, value in case.items() if name != "either"}
    checked = [check_one(program, folder, {**common, **more}) for more in case.get("either", [{}])]
    return next((c for c in checked if not c.wrong), checked[0])


def check_one(program, folder, case):
    with tempfile.TemporaryDirectory() as scratch:
        checked = Case(program, folder, case)
        try:
            checked.run(scratch)
        except Exception as problem:  # A case must not end the others.
            checked.wrong.append(f"{type(problem).__name__}: {problem}")
        return checked


def result(checked):
    return {
        "kind": checked.case["kind"],
        "name": checked.case["name"],
        "path": checked.path,
        "options": checked.case.get("options", {}),
        "peer": checked.case.get("peer"),
        "wrong": checked.wrong,
        "not_checked": checked.not_checked,
    }


def table(results):
    kinds = {}
    for r in results:
        row = kinds.setdefault(r["kind"], [0, 0, 0])
        row[0] += 1
        row[1] += bool(r["wrong"])
        row[2] += bool(r["not_checked"])
    total = [sum(row[n] for row in kinds.values()) for n in range(3)]
    width = max(len(k) for k in [*kinds, "kind"])
    lines = [f"{'kind':<{width}}  cases  wrong  not checked"]
    for kind, row in [*kinds.items(), ("all", total)]:
        lines.append(f"{kind:<{width}}  {row[0]:5}  {row[1]:5}  {row[2]:11}")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program")
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--json", action="store_true", help="every case as JSON, instead of a table")
    parser.add_argument("--kind", help="only kinds that hold this text")
    parser.add_argument("--name", help="only names that hold this text")
    parser.add_argument("-v", "--verbose", action="store_true", help="with what is wrong")
    parser.add_argument("-j", type=int, default=os.cpu_count(), help="programs at once")
    arguments = parser.parse_args()
    jobs = []
    for folder in arguments.folders:
        with open(os.path.join(folder, "cases.json"), encoding="utf-8") as file:
            for case in json.load(file):
                if arguments.kind and arguments.kind not in case["kind"]:
                    continue
                if arguments.name and arguments.name not in case["name"]:
                    continue
                jobs.append((arguments.program, folder, case))
    with concurrent.futures.ThreadPoolExecutor(arguments.j) as pool:
        results = [result(c) for c in pool.map(lambda job: check(*job), jobs)]
    if arguments.json:
        print(json.dumps(results, indent=1, ensure_ascii=False))
    else:
        if arguments.verbose:
            for r in results:
                for line in r["wrong"]:
                    print(f"{r['kind']}: {r['name']}: {line}")
        print(table(results))
    sys.exit(any(r["wrong"] for r in results))


if __name__ == "__main__":
    main()

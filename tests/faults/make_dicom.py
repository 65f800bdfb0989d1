#!/usr/bin/env python3
"""Makes small faulty DICOM files, and `cases.json`: what must come out of each.

    make_dicom.py FOLDER

The kinds are those that people report to the makers of DICOM readers, and what the standard permits
but few files use. Each module of `dicom_cases` makes one kind. The same files come from every run.
Needs numpy, pydicom, highdicom, imagecodecs, nibabel and SimpleITK. `check.py` runs a program over them.
"""

import importlib
import json
import os
import sys

from dicom_cases.base import Cases

KINDS = ("un", "syntax", "characters", "grouping", "times", "frames", "made_up", "notices", "jpeg", "apart")


def main():
    folder = sys.argv[1]
    if os.path.exists(folder) and os.listdir(folder):
        sys.exit(f"{folder} is not empty")
    cases = Cases(folder)
    for kind in KINDS:
        importlib.import_module(f"dicom_cases.{kind}").make(cases)
    names = [(case["kind"], case["name"]) for case in cases.list]
    assert len(names) == len(set(names)), "a name occurs twice"
    with open(os.path.join(folder, "cases.json"), "w", encoding="utf-8") as file:
        lines = ",\n".join(json.dumps(case, ensure_ascii=False) for case in cases.list)
        file.write(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()

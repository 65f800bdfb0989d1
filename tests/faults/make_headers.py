#!/usr/bin/env python3
"""Makes small images, meshes and transforms with unusual headers, and `cases.json`: what must come
out of each.

    make_headers.py FOLDER

Each module of `header_cases` makes a few kinds. The same files come from every run. Needs numpy,
pynrrd, nibabel, SimpleITK, trimesh and h5py. `check.py` runs a program over them.
"""

import importlib
import json
import os
import sys

from header_cases.base import Cases

MODULES = (
    "nrrd_files",
    "segmentations",
    "nifti_files",
    "metaimages",
    "vtk_files",
    "polygons",
    "meshes",
    "itk",
    "other_transforms",
)


def main():
    folder = sys.argv[1]
    if os.path.exists(folder) and os.listdir(folder):
        sys.exit(f"{folder} is not empty")
    cases = Cases(folder)
    for module in MODULES:
        importlib.import_module(f"header_cases.{module}").make(cases)
    names = [(case["kind"], case["name"]) for case in cases.list]
    assert len(names) == len(set(names)), "a name occurs twice"
    with open(os.path.join(folder, "cases.json"), "w", encoding="utf-8") as file:
        lines = ",\n".join(json.dumps(case, ensure_ascii=False) for case in cases.list)
        file.write(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Packs test files for the repository.

    pack.py FOLDER AREA.zip.bz2

A zip of the folder, not compressed, then compressed as a whole: the files resemble each other. The
same bytes come from every run.
"""

import bz2
import io
import os
import sys
import zipfile

folder, out = sys.argv[1:3]
names = []
for place, folders, files in os.walk(folder):
    folders.sort()
    names += [os.path.relpath(os.path.join(place, name), folder) for name in files]
held = io.BytesIO()
with zipfile.ZipFile(held, "w", zipfile.ZIP_STORED) as archive:
    for name in sorted(names):
        with open(os.path.join(folder, name), "rb") as file:
            archive.writestr(zipfile.ZipInfo(name.replace(os.sep, "/"), (1980, 1, 1, 0, 0, 0)), file.read())
with open(out, "wb") as file:
    file.write(bz2.compress(held.getvalue(), 9))
print(f"{len(names)} files, {os.path.getsize(out)} bytes")

"""Kinds of faulty DICOM files, a module for each."""

"""Every file that is read or written: one door for each format, which checks everything in it.

Readers raise ``InputError`` with the file, the field, what was found and what was expected. Writers
flush and check a file before they move it into place. Begin with ``recordings.recording`` (what a
command reads), ``motion_npz`` (what it writes) and ``files.writing`` (how anything is written).
"""

"""What a file is by its first bytes, whatever it is called."""

from __future__ import annotations

from pathlib import Path

HEAD = 2048
HDF5 = b"\x89HDF\r\n\x1a\n"
SIGNATURES = {
    b"MATLAB 5.0 MAT-file": "MAT file of version 5 or 7",
    b"MATLAB 7.3 MAT-file": "MAT file of version 7.3",
    HDF5: "HDF5 file",
    b"CDF\x01": "NetCDF file",
    b"CDF\x02": "NetCDF file",
    b"CDF\x05": "NetCDF file",
    b"PAR1": "Parquet file",
    b"PK\x03\x04": "ZIP archive",
    b"\x93NUMPY": "single NumPy array",
    b"\xd0\xcf\x11\xe0": "old Excel or Word file",
    b"\x1f\x8b": "gzip archive",
    b"%PDF": "PDF",
    b"\x80\x03": "Python pickle, which is never read",
    b"\x80\x04": "Python pickle, which is never read",
    b"\x80\x05": "Python pickle, which is never read",
}
"""By what such files begin with; a MAT file of version 4 begins with nothing of its own."""


def seems(file: Path) -> str:
    """What a file's first bytes say that it is; empty if they say nothing."""
    with file.open("rb") as stream:
        head = stream.read(HEAD)
    # MATLAB writes objects of version 7.3 below a header of its own, which some programs leave empty.
    if head[512:].startswith(HDF5):
        return "MAT file of version 7.3"
    for signature, kind in SIGNATURES.items():
        if head.startswith(signature):
            if kind == "ZIP archive" and b"[Content_Types].xml" in head:
                return "Excel or Word file"
            return kind
    if len(head) >= 512 and head[1] == 0x50 and 2 <= head[0] < 32:
        return "C3D file"
    return "text" if _is_text(head) else ""


def _is_text(head: bytes) -> bool:
    try:
        words = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:  # a letter cut in two at the end is none the less text
            return False
        words = head[: error.start].decode("utf-8-sig")
    return all(letter.isprintable() or letter in "\r\n\t" for letter in words)

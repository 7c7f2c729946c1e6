"""Damage to files: each mutation takes a random generator and bytes, and returns other bytes."""

import io
import re
import struct
import zipfile
import zlib

import h5py

TOKENS = [
    b"nan",
    b"-inf",
    b"1e999",
    b"-1e308",
    b"9" * 400,
    b"0x7f",
    b"True",
    b'"',
    b"'",
    b"\0",
    b"\0\0\0\0",
    b"",
    b"/",
]
TOKENS += [
    "°µ𝛼".encode(),
    b"\xff\xfe",
    b"\xed\xa0\x80",
    b",",
    b"\t",
    b"\r",
    b"\n\n",
    b"..",
    b"[bold]",
    b"\x1b[2J",
    b"$x$",
]
EXTREMES = (
    0,
    1,
    2,
    3,
    7,
    8,
    127,
    255,
    2**15 - 1,
    2**15,
    2**16 - 1,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**62,
    2**63 - 1,
)
EXTREMES += (2**63, 2**64 - 8, 2**64 - 1)


def flip_bits(random, content):
    damaged = bytearray(content)
    for place in random.integers(len(content), size=random.integers(1, 9)):
        damaged[place] ^= 1 << int(random.integers(8))
    return bytes(damaged)


def blank(random, content):
    """A stretch of zeros or ones, as a disk leaves it; mostly short."""
    first, end = block(random, content)
    return content[:first] + random.choice([b"\0", b"\xff"]) * (end - first) + content[end:]


def cut(random, content):
    return content[: random.integers(1, len(content) + 1)]


def repeat(random, content):
    first, end = block(random, content)
    return content[:end] + content[first:end] * int(random.integers(1, 20)) + content[end:]


def remove(random, content):
    first, end = block(random, content)
    return content[:first] + content[end:]


def swap(random, content):
    first, end = block(random, content)
    other = int(random.integers(end, len(content) + 1))
    return content[:first] + content[end:other] + content[first:end] + content[other:]


def set_integer(random, content):
    """Set an integer of 2, 4 or 8 bytes, mostly aligned, to an extreme or close to what it was."""
    form = str(random.choice(list("<>"))) + str(random.choice(list("HIQ")))
    width = struct.calcsize(form)
    if len(content) < width:
        return content
    place = int(random.integers(len(content) - width + 1))
    place -= place % width if random.random() < 0.8 else 0
    was = struct.unpack_from(form, content, place)[0]
    value = (
        was + int(random.integers(-9, 10))
        if random.random() < 0.2
        else EXTREMES[random.integers(len(EXTREMES))]
    )
    return content[:place] + struct.pack(form, value % 256**width) + content[place + width :]


def replace_token(random, content):
    """A word or number of the text in the file, of the same length in half of the cases."""
    words = [match.span() for match in re.finditer(rb"[\w.+-]{2,}", content)]
    if not words:
        return content
    first, end = words[random.integers(len(words))]
    token = TOKENS[random.integers(len(TOKENS))]
    if random.random() < 0.5:
        token = token[: end - first].ljust(end - first, b"\0")
    return content[:first] + token + content[end:]


def block(random, content):
    """Where a block begins and ends: of a few bytes, of 512, or of any length."""
    first = int(random.integers(len(content)))
    length = int(
        random.choice(
            [random.integers(1, 17), 512, random.integers(1, len(content) + 1)], p=[0.7, 0.15, 0.15]
        )
    )
    return first, min(first + length, len(content))


PLAIN = (
    flip_bits,
    blank,
    cut,
    repeat,
    remove,
    swap,
    set_integer,
    set_integer,
    set_integer,
    replace_token,
)


def damaged(random, content):
    """One to three mutations, one after the other; mostly filled up to the old length."""
    length = len(content) if random.random() < 0.5 else 0
    for _ in range(random.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        content = PLAIN[random.integers(len(PLAIN))](random, content) or content
    return content.ljust(length, b"\0")


def spliced(random, content, other):
    """The beginning of one file and the end of another."""
    return content[: random.integers(1, len(content))] + other[random.integers(len(other)) :]


def inside_mat(random, content):
    """Damage one variable of a MAT file before it is compressed: so the parser sees it."""
    elements, place = [], 128
    while place + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, place)
        elements.append((kind, content[place + 8 : place + 8 + size]))
        place += 8 + size
    chosen = int(random.integers(len(elements)))
    kind, data = elements[chosen]
    elements[chosen] = (
        15,
        zlib.compress(damaged(random, zlib.decompress(data))) if kind == 15 else data,
    )
    return content[:128] + b"".join(
        struct.pack("<II", kind, len(data)) + data for kind, data in elements
    )


def inside_zip(random, content):
    """One member of an archive, with the right length and checksum."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(item, archive.read(item)) for item in archive.infolist()]
    chosen, written = int(random.integers(len(members))), io.BytesIO()
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, (item, data) in enumerate(members):
            archive.writestr(item, damaged(random, data) if number == chosen else data)
    return written.getvalue()


def inside_chunk(random, content):
    """One compressed chunk of an HDF5 file, shorter, longer or other than it should be."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "r+") as root:
        chunked = []
        root.visititems(
            lambda _, item: (
                chunked.append(item) if getattr(item, "compression", None) == "gzip" else None
            )
        )
        data = chunked[random.integers(len(chunked))].id
        place = data.get_chunk_info(0).chunk_offset
        mask, values = data.read_direct_chunk(place)
        data.write_direct_chunk(
            place, zlib.compress(damaged(random, zlib.decompress(values))), mask
        )
    return stream.getvalue()

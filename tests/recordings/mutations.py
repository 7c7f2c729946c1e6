"""Damage to files: each mutation takes a random generator and bytes, and returns other bytes."""

import io
import re
import struct
import zlib

import h5py

TOKENS = [b"nan", b"-inf", b"1e999", b"9" * 400, b"True", b'"', b"\0\0\0\0", b"/", b"\xed\xa0\x80"]
TOKENS += ["°µ𝛼".encode(), b"\xff\xfe", b",", b"\t", b"\n\n", b"..", b"\x1b[2J"]
EXTREMES = (
    0,
    1,
    2,
    8,
    *(2**bits + sign for bits in (7, 8, 15, 16, 31, 32, 63) for sign in (-1, 0)),
)


def flip_bits(random, content):
    damaged = bytearray(content)
    for place in random.integers(len(content), size=random.integers(1, 9)):
        damaged[place] ^= 1 << int(random.integers(8))
    return bytes(damaged)


def cut(random, content):
    return content[: random.integers(1, len(content) + 1)]


def change_block(random, content):
    """Blank a block, as a disk leaves it, or remove or repeat it."""
    first = int(random.integers(len(content)))
    end = first + int(random.choice([random.integers(1, 17), 512, len(content)], p=[0.7, 0.2, 0.1]))
    block, after = content[first:end], content[end:]
    changes = [b"\0" * len(block), b"\xff" * len(block), b"", block * int(random.integers(2, 21))]
    return content[:first] + changes[random.integers(len(changes))] + after


def set_integer(random, content):
    """Set an integer of 2, 4 or 8 bytes, mostly aligned, to an extreme."""
    form = str(random.choice(["<", ">"])) + str(random.choice(["H", "I", "Q"]))
    width = struct.calcsize(form)
    place = int(random.integers(max(len(content) - width, 1)))
    place -= place % width if random.random() < 0.8 else 0
    value = struct.pack(form, EXTREMES[random.integers(len(EXTREMES))] % 256**width)
    return content[:place] + value + content[place + width :]


def replace_token(random, content):
    """A word or number of the text in the file."""
    words = [match.span() for match in re.finditer(rb"[\w.+-]{2,}", content)] or [(0, 0)]
    first, end = words[random.integers(len(words))]
    return content[:first] + TOKENS[random.integers(len(TOKENS))] + content[end:]


PLAIN = (flip_bits, cut, *[change_block] * 4, *[set_integer] * 3, replace_token)


def damaged(random, content):
    """One to three mutations, one after the other; mostly filled up to the old length."""
    length = len(content) if random.random() < 0.5 else 0
    for _ in range(random.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        content = PLAIN[random.integers(len(PLAIN))](random, content) or content
    return content.ljust(length, b"\0")


def inside_mat(random, content):
    """Damage one variable of a MAT file before it is compressed: so the parser sees it."""
    elements, place = [], 128
    while place + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, place)
        elements.append((kind, content[place + 8 : place + 8 + size]))
        place += 8 + size
    chosen = int(random.integers(len(elements)))
    kind, data = elements[chosen]
    if kind == 15:
        elements[chosen] = kind, zlib.compress(damaged(random, zlib.decompress(data)))
    parts = [struct.pack("<II", kind, len(data)) + data for kind, data in elements]
    return content[:128] + b"".join(parts)


def inside_chunk(random, content):
    """One compressed chunk of an HDF5 file, shorter, longer or other than it should be."""
    stream, items = io.BytesIO(content), {}
    with h5py.File(stream, "r+") as root:
        root.visititems(items.__setitem__)
        chunked = [each for each in items.values() if getattr(each, "compression", 0) == "gzip"]
        data = chunked[random.integers(len(chunked))].id
        place = data.get_chunk_info(0).chunk_offset
        mask, values = data.read_direct_chunk(place)
        changed = zlib.compress(damaged(random, zlib.decompress(values)))
        data.write_direct_chunk(place, changed, mask)
    return stream.getvalue()

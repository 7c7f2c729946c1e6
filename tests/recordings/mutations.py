"""Damage to files: each mutation takes a random generator and bytes, and returns other bytes."""

import struct
import zlib

EXTREMES = (0, 1, 8, *(2**bits - sign for bits in (7, 8, 15, 16, 31, 32, 63) for sign in (0, 1)))


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
    block = content[first:end]
    changes = [b"\0" * len(block), b"\xff" * len(block), b"", block * int(random.integers(2, 21))]
    return content[:first] + changes[random.integers(len(changes))] + content[end:]


def set_integer(random, content):
    """Set an integer of 2, 4 or 8 bytes, mostly aligned, to an extreme."""
    form = str(random.choice(["<", ">"])) + str(random.choice(["H", "I", "Q"]))
    width = struct.calcsize(form)
    place = int(random.integers(max(len(content) - width, 1)))
    place -= place % width if random.random() < 0.8 else 0
    value = struct.pack(form, EXTREMES[random.integers(len(EXTREMES))] % 256**width)
    return content[:place] + value + content[place + width :]


KINDS = (flip_bits, cut, *[change_block] * 4, *[set_integer] * 4)


def damaged(random, content):
    """One to three mutations, one after the other; mostly filled up to the old length."""
    length = len(content) if random.random() < 0.5 else 0
    for _ in range(random.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        content = KINDS[random.integers(len(KINDS))](random, content) or content
    return content.ljust(length, b"\0")


def inside_mat(random, content):
    """Damage one variable of a MAT file before it is compressed: so the parser sees it."""
    elements, place = [], 128
    while place + 8 <= len(content):
        _, size = struct.unpack_from("<II", content, place)
        elements.append(content[place : place + 8 + size])
        place += 8 + size
    chosen = random.choice([number for number, each in enumerate(elements) if each[0] == 15])
    data = zlib.compress(damaged(random, zlib.decompress(elements[chosen][8:])))
    elements[chosen] = struct.pack("<II", 15, len(data)) + data
    return content[:128] + b"".join(elements)

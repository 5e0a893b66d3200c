"""Just enough PNG for the demo's picture: 8-bit RGB, RGBA or grey in, RGB out. Python's own library has none."""

import struct
import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read(data):
    """Width, height, and rows of RGB bytes."""
    if not data.startswith(SIGNATURE):
        raise ValueError("not a PNG file")
    at, packed, header = len(SIGNATURE), b"", None
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed += body
        at += length + 12
    width, height, depth, colour, _, _, interlaced = header
    channels = {0: 1, 2: 3, 4: 2, 6: 4}.get(colour)
    if depth != 8 or channels is None or interlaced:
        raise ValueError(f"a PNG of depth {depth}, colour type {colour}, interlacing {interlaced} is not for here")
    rows, above = [], bytearray(width * channels)
    raw = zlib.decompress(packed)
    for y in range(height):
        start = y * (width * channels + 1)
        above = unfilter(raw[start], bytearray(raw[start + 1:start + 1 + width * channels]), above, channels)
        rows.append(to_rgb(above, channels))
    return width, height, rows


def unfilter(kind, row, above, step):
    """A row with the filter of the format's section 9 taken off."""
    for i in range(len(row)):
        a = row[i - step] if i >= step else 0
        b = above[i]
        if kind == 1:
            predicted = a
        elif kind == 2:
            predicted = b
        elif kind == 3:
            predicted = (a + b) // 2
        elif kind == 4:
            c = above[i - step] if i >= step else 0
            predicted = min((a, b, c), key=lambda v, p=a + b - c: abs(p - v))
        else:
            return row
        row[i] = (row[i] + predicted) & 255
    return row


def to_rgb(row, channels):
    if channels == 3:
        return bytes(row)
    first = 0 if channels >= 3 else None
    planes = [row[(channel if first == 0 else 0)::channels] for channel in range(3)]
    return bytes(value for pixel in zip(*planes) for value in pixel)


def write(width, height, rows):
    """The bytes of an RGB file."""
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    raw = b"".join(b"\0" + row for row in rows)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")


def beside(pictures, gap=4):
    """Pictures of one height side by side, with a white gap."""
    heights = {height for _, height, _ in pictures}
    if len(heights) != 1:
        raise ValueError(f"pictures of different heights: {sorted(heights)}")
    (height,) = heights
    width = sum(width for width, _, _ in pictures) + gap * (len(pictures) - 1)
    white = b"\xff" * (3 * gap)
    rows = [white.join(rows[y] for _, _, rows in pictures) for y in range(height)]
    return write(width, height, rows)

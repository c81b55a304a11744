"""Certificates that are not what was written."""

import hashlib
import json
import zlib


def changed(path, alter, *, entries=None):
    """The file with another header or other entries, and its digest right again."""
    rest = path.read_bytes().partition(b"\n")[2]
    text, _, packed = rest.partition(b"\n")
    header = json.loads(text)
    alter(header)
    if entries is not None:
        packed = zlib.compress(entries(zlib.decompress(packed)))
        header["entries"] = len(zlib.decompress(packed)) // 10
    content = json.dumps(header).encode() + b"\n" + packed
    first = f"holdfast-certificate 1 {hashlib.sha256(content).hexdigest()}\n".encode()
    other = path.with_name("changed.certificate")
    other.write_bytes(first + content)
    return other

"""Bytes that programs other than ours sent, with their sources."""

import re
from pathlib import Path


def recorded(file, name):
    """The bytes of a block: its name on a line of its own, then hexadecimal lines."""
    text = (Path(__file__).parent / file).read_text()
    (found,) = re.findall(rf"^{name}\n((?:[0-9a-f ]+\n)+)", text, re.M)
    return bytes.fromhex(found)

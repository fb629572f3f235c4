"""Templates as bytecode, kept in the cache beside the libraries.

To parse the templates of a method's engine takes longer than to integrate a small scene with it.
"""

from __future__ import annotations

import hashlib
import sys
from typing import TYPE_CHECKING

import jinja2

from cotree.build.cache import TEMPLATE, find_bytes, keep_bytes

if TYPE_CHECKING:
    from jinja2.bccache import Bucket


class KeptBytecode(jinja2.BytecodeCache):
    """Bytecode of templates, found by the text of each.

    A cache folder that cannot be used costs time and nothing else: templates are then parsed.

    Parameters
    ----------
    options : str
        The options of the environment that the bytecode depends on.
    """

    def __init__(self, options: str) -> None:
        self._options = f"{options} {jinja2.__version__} {sys.version}"

    def load_bytecode(self, bucket: Bucket) -> None:
        """Fill a bucket, if its template was parsed before; see Jinja."""
        found = find_bytes(self._key(bucket), TEMPLATE)
        if found is not None:
            bucket.bytecode_from_string(found)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep what was parsed; see Jinja."""
        keep_bytes(bucket.bytecode_to_string(), self._key(bucket), TEMPLATE)

    def _key(self, bucket: Bucket) -> str:
        # The bucket's own key is that of the template's path, its checksum that of the text.
        text = f"{self._options} {bucket.key} {bucket.checksum}"
        return hashlib.sha256(text.encode()).hexdigest()

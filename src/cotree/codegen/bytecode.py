"""Templates as bytecode, kept in the cache beside the libraries.

To parse the templates of a method's engine takes longer than to integrate a small scene with it.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
from typing import TYPE_CHECKING

import jinja2

from cotree.build.cache import TEMPLATE, find_published, private_directory, publish
from cotree.errors import BuildError

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
        with contextlib.suppress(BuildError, OSError):
            found = find_published(self._key(bucket), TEMPLATE)
            if found is not None:
                bucket.bytecode_from_string(found.read_bytes())

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep what was parsed; see Jinja."""
        with contextlib.suppress(BuildError, OSError), private_directory() as directory:
            written = directory / "template"
            written.write_bytes(bucket.bytecode_to_string())
            publish(written, self._key(bucket), TEMPLATE)

    def _key(self, bucket: Bucket) -> str:
        # The bucket's own key is that of the template's path, its checksum that of the text.
        text = f"{self._options} {bucket.key} {bucket.checksum}"
        return hashlib.sha256(text.encode()).hexdigest()

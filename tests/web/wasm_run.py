"""Runs of a page's program with wasmtime, as templates/html/engine.js runs it."""

from __future__ import annotations

import base64
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import wasmtime

ENGINE = wasmtime.Engine()


@dataclass
class Run:
    """Results of a run: times, one row for each time, events, and the messages."""

    t: np.ndarray
    states: np.ndarray
    slopes: np.ndarray
    outputs: np.ndarray
    event_times: np.ndarray
    message: str
    failed: bool


def run_page(
    data: dict[str, Any],
    method: str,
    points: int,
    parameters: dict[str, float] | None = None,
    initial: dict[str, float] | None = None,
) -> Run:
    """Run the program of a page's data."""
    module = wasmtime.Module(ENGINE, zlib.decompress(base64.b64decode(data["wasm"])))
    store = wasmtime.Store(ENGINE)
    text = bytearray()
    exports: dict[str, Any] = {}

    def fd_write(_: int, vectors: int, n: int, written: int) -> int:
        memory, total = exports["memory"], 0
        for i in range(n):
            start = vectors + 8 * i
            at, length = struct.unpack("<II", bytes(memory.read(store, start, start + 8)))
            text.extend(memory.read(store, at, at + length))
            total += length
        memory.write(store, struct.pack("<I", total), written)
        return 0

    known = {"fd_write": fd_write, "fd_seek": lambda *_: 70, "fd_close": lambda _: 0}
    functions = [wasmtime.Func(store, row.type, known[row.name]) for row in module.imports]
    instance = wasmtime.Instance(store, module, functions)
    exports.update(instance.exports(store))

    def call(name: str, *arguments: Any) -> Any:
        return exports[name](store, *arguments)

    def numbers(start: int, n: int) -> np.ndarray:
        return np.frombuffer(exports["memory"].read(store, start, start + 8 * n), dtype="<f8")

    call("_initialize")
    values = [(parameters or {}).get(row["name"], row["value"]) for row in data["parameters"]]
    place = call("page_parameters")
    exports["memory"].write(store, np.array(values, dtype="<f8").tobytes(), place)
    names = [row["name"] for row in data["states"]]
    for name, value in (initial or {}).items():
        call("page_initial", names.index(name), value)
    failed = call("page_run", data["methods"].index(method), data["t_end"], points)
    n, m, k = len(names), len(data["sensitivities"]), data["n_outputs"]
    rows, width = call("page_n_rows"), (1 + m) * (n + k) + 1 + len(data["inputs"])
    table = numbers(call("page_rows"), rows * width).reshape(rows, width)
    n_events = call("page_n_events")
    events = numbers(call("page_events"), n_events * (2 + m)).reshape(n_events, 2 + m)
    first = 1 + n * (1 + m)
    return Run(
        table[:, 0],
        table[:, 1 : 1 + n],
        table[:, 1 + n : first],
        table[:, first : first + len(data["outputs"])],
        events[:, 0],
        text.decode(),
        failed != 0,
    )

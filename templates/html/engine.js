// The compiled program of a scene: each run starts it again, so that no run affects another one.
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

const loadEngine = async (data) => {
  const unpacked = new Blob([bytesOf(data.wasm)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const module = await WebAssembly.compile(await new Response(unpacked).arrayBuffer());
  const nStates = data.states.length, nParameters = data.parameters.length;
  const nOutputs = data.n_outputs, nSensitivities = data.sensitivities.length;
  // Columns of a row: time, states and their sensitivities, outputs and theirs, inputs.
  const firstOutput = 1 + nStates * (1 + nSensitivities);
  const firstInput = firstOutput + nOutputs * (1 + nSensitivities);
  const width = firstInput + data.inputs.length;
  const first = { x: 1, o: firstOutput, u: firstInput };
  const count = { x: nStates, o: nOutputs, u: 0 };

  // Run with `parameters` (a list), `initial` (pairs of state and value), `method`, `end`, `points`.
  const run = (request) => {
    const begun = performance.now();
    let text = "", memory = null;
    const decoder = new TextDecoder();
    const system = {
      // Messages are the only output of the program.
      fd_write(_, vectors, n, written) {
        const view = new DataView(memory.buffer);
        let total = 0;
        for (let i = 0; i < n; i++) {
          const at = view.getUint32(vectors + 8 * i, true), length = view.getUint32(vectors + 8 * i + 4, true);
          text += decoder.decode(new Uint8Array(memory.buffer, at, length), { stream: true });
          total += length;
        }
        view.setUint32(written, total, true);
        return 0;
      },
      fd_seek: () => 70, // a pipe cannot seek
      fd_close: () => 0,
      proc_exit(code) { throw new Error(`the program ended with code ${code}`); },
    };
    let failed = false, rows = new Float64Array(0), n = 0, events = [], steps = 0, stiffSince = -1;
    try {
      const program = new WebAssembly.Instance(module, { wasi_snapshot_preview1: system }).exports;
      memory = program.memory;
      program._initialize();
      new Float64Array(memory.buffer, program.page_parameters(), nParameters).set(request.parameters);
      for (const [state, value] of request.initial) program.page_initial(state, value);
      failed = program.page_run(request.method, request.end, request.points) !== 0;
      n = program.page_n_rows();
      rows = new Float64Array(memory.buffer, program.page_rows(), n * width);
      steps = program.page_n_steps();
      if (steps) stiffSince = program.page_stiff_since();
      const nEvents = program.page_n_events(), record = 2 + nSensitivities;
      const records = new Float64Array(memory.buffer, program.page_events(), nEvents * record);
      for (let i = 0; i < nEvents; i++) events.push({ t: records[i * record], event: records[i * record + 1] });
    } catch (error) { // a trap, such as exhausted memory
      failed = true;
      text = text || `${data.name}: ${error.message}.`;
    }
    const column = (start) => {
      const found = new Float64Array(n);
      for (let i = 0; i < n; i++) found[i] = rows[i * width + start];
      return found;
    };
    const cells = new Map();
    const cached = (start) => {
      if (!cells.has(start)) cells.set(start, column(start));
      return cells.get(start);
    };
    return {
      n, failed, steps, stiffSince, events,
      message: text.trim(),
      milliseconds: performance.now() - begun,
      t: column(0),
      // Values of state, output or input `i` over time; `kind` is "x", "o" or "u".
      values: (kind, i) => cached(first[kind] + i),
      // Derivatives with respect to sensitivity `j`; inputs have none.
      slopes: (kind, i, j) => (count[kind] ? cached(first[kind] + count[kind] * (1 + j) + i) : null),
    };
  };
  return { run };
};

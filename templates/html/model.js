// The page of a model. Its state is the scene's data, the values chosen, and the last run.
(async () => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const element = (name) => document.getElementById(name);
  const parameters = data.parameters.map((row) => row.value);
  const initial = new Map(); // values of states that replace those of the scene
  let engine = null, result = null, tEnd = data.t_end, method = 0;
  let held = null; // the slider that is being moved, and the run before it moved
  let cursorTime = null;

  const showMessage = (text) => {
    element("message").textContent = text;
    element("message").hidden = !text;
  };

  // Quantities, with the first letter of their kind as in the engine.
  const quantities = [
    ...data.outputs.map((row, i) => ({ ...row, kind: "o", i })),
    ...data.states.map((row, i) => ({ ...row, kind: "x", i })),
    ...data.inputs.map((row, i) => ({ ...row, kind: "u", i })),
  ].map((row, color) => ({ ...row, id: row.kind + row.i, label: row.name, color: color % 8 }));
  const shown = new Set(data.shown);
  let along = -1; // index of the sensitivity that is shown; -1: values
  let charts = [];

  const unitAlong = (unit) => {
    if (along < 0) return unit;
    const row = data.sensitivities[along];
    const own = (row.parameter >= 0 ? data.parameters[row.parameter] : data.states[row.state]).unit;
    return own === unit ? "" : `${unit || "1"} / ${own ? (own.includes(" ") || own.includes("/") ? `(${own})` : own) : "1"}`;
  };
  const setTime = (t, isChosen) => {
    cursorTime = t;
    for (const chart of charts) chart.point(t);
    if (isChosen && t !== null && viewer) viewer.seekTime(t);
  };
  const layOutCharts = () => {
    const byUnit = new Map();
    for (const row of quantities) {
      if (!shown.has(row.id) || (along >= 0 && row.kind === "u")) continue;
      if (!byUnit.has(row.unit)) byUnit.set(row.unit, []);
      byUnit.get(row.unit).push(row);
    }
    charts = [...byUnit].map(([unit, rows]) => {
      // Colours distinguish the curves of one chart.
      const own = rows.map((row, color) => ({ ...row, color: color % 8 }));
      return { ...createChart(unitAlong(unit), own, setTime), rows };
    });
    element("charts").replaceChildren(...charts.map((chart) => chart.root));
    drawCharts();
  };
  const valuesOf = (run, row) => (along < 0 ? run.values(row.kind, row.i) : run.slopes(row.kind, row.i, along));
  const drawCharts = () => {
    if (!result || result.n < 2) return;
    const change = held && held.isMoved ? held.value() - held.before : 0;
    for (const chart of charts) {
      const drawn = chart.rows.map((row) => {
        const lines = { exact: { t: result.t, values: valuesOf(result, row) } };
        if (change !== 0) {
          const { base } = held, values = valuesOf(base, row);
          lines.base = { t: base.t, values };
          const slopes = along < 0 && held.sensitivity >= 0 ? base.slopes(row.kind, row.i, held.sensitivity) : null;
          if (slopes) lines.predicted = { t: base.t, values: values.map((v, k) => v + slopes[k] * change) };
        }
        return lines;
      });
      chart.draw(drawn, tEnd, held !== null);
      chart.point(cursorTime);
    }
    let text = along < 0 ? "" : `Derivatives of the curves with respect to ${data.sensitivities[along].name}.`;
    if (change !== 0) {
      text = `Thin: before ${held.name} changed.`;
      if (along < 0) text += held.sensitivity >= 0 ? " Dashed: predicted by the sensitivity." : ` The model has no sensitivity to ${held.name}.`;
    }
    element("key").textContent = text;
  };

  // Quaternions from two columns of a rotation matrix, with continuous signs.
  let viewer = null;
  const motionOf = (run) => {
    const tracks = data.motion.tracks.map(() => ({ p: new Float64Array(3 * run.n), q: new Float64Array(4 * run.n) }));
    const centres = new Float64Array(3 * run.n), output = (i) => run.values("o", i);
    data.motion.tracks.forEach((track, j) => {
      const { p, q } = tracks[j];
      const at = track.at < 0 ? null : [0, 1, 2].map((k) => output(track.at + k));
      const turning = track.turning < 0 ? null : [0, 1, 2, 3, 4, 5].map((k) => output(track.turning + k));
      for (let n = 0; n < run.n; n++) {
        if (at) for (let k = 0; k < 3; k++) p[3 * n + k] = at[k][n];
        const own = turning ? quaternionOf(turning.map((row) => row[n]), track.turn) : [1, 0, 0, 0];
        const sign = n && own.reduce((sum, v, k) => sum + v * q[4 * n - 4 + k], 0) < 0 ? -1 : 1;
        for (let k = 0; k < 4; k++) q[4 * n + k] = sign * own[k];
        for (let k = 0; k < 3; k++) centres[3 * n + k] += p[3 * n + k] / tracks.length;
      }
    });
    if (!data.motion.follows) for (let n = 0; n < run.n; n++) centres.set(data.motion.centre, 3 * n);
    return [tracks, centres];
  };
  const quaternionOf = ([a, b, c, d, e, f], m) => {
    const z = [b * f - c * e, c * d - a * f, a * e - b * d], u = [a, b, c], v = [d, e, f];
    // Entry (i, j) of the rotation, times the constant rotation m.
    const r = (i, j) => u[i] * m[j] + v[i] * m[3 + j] + z[i] * m[6 + j];
    const trace = r(0, 0) + r(1, 1) + r(2, 2), squares = [1 + trace, ...[0, 1, 2].map((i) => 1 - trace + 2 * r(i, i))];
    const products = { 0: [squares[0], r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)] };
    [[0, 1, 2], [1, 2, 0], [2, 0, 1]].forEach(([i, j, k]) => {
      const row = [r(k, j) - r(j, k), 0, 0, 0];
      [row[1 + i], row[1 + j], row[1 + k]] = [squares[1 + i], r(i, j) + r(j, i), r(i, k) + r(k, i)];
      products[1 + i] = row;
    });
    // Divide by the largest component (S. Shepperd, 1978).
    const largest = products[squares.indexOf(Math.max(...squares))], size = Math.hypot(...largest) || 1;
    return largest.map((value) => value / size);
  };

  // Largest distance of a track from the centre of the picture.
  const extent = (tracks, centres) => {
    let largest = 0;
    for (const { p } of tracks) {
      for (let k = 0; k < p.length; k += 3) largest = Math.max(largest, Math.hypot(p[k] - centres[k], p[k + 1] - centres[k + 1], p[k + 2] - centres[k + 2]));
    }
    return largest;
  };
  let firstExtent = 0, growth = 1;

  const showRun = () => {
    const notes = [result.message.replaceAll(`${data.name}: `, "")];
    if (result.stiffSince >= 0) notes.push(`The problem is stiff from t = ${formatNumber(result.stiffSince)} s on: the method rodas5 may take far fewer steps.`);
    showMessage(notes.filter(Boolean).join(" "));
    document.body.dataset.failed = result.failed;
    const count = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;
    element("status").textContent = `${count(result.steps, "step")}, ${result.milliseconds.toFixed(1)} ms`;
    // Without a run, the curves of the last one remain, but pale.
    element("charts").classList.toggle("stale", result.n < 2);
    if (result.n > 1) drawCharts();
    if (viewer && result.n > 1) {
      const [tracks, centres] = motionOf(result), own = extent(tracks, centres);
      firstExtent = firstExtent || own;
      // Small changes of the size do not move the camera.
      const size = own / firstExtent;
      if (size > growth || size < 0.7 * growth) growth = Math.max(size, 0.05);
      viewer.setMotion(tracks, centres, result.t, growth);
    }
    const list = result.events.slice(0, 40).map((row) => `${data.events[row.event]} at ${formatNumber(row.t)} s`);
    if (result.events.length > 40) list.push(`${result.events.length - 40} more`);
    element("events").hidden = !list.length;
    element("events").querySelector("p").textContent = list.join(", ");
  };
  const evaluate = () => {
    result = engine.run({ parameters, initial, method, end: tEnd, points: data.points });
    showRun();
  };
  let isAsked = false;
  const run = () => {
    if (isAsked || !engine) return;
    isAsked = true;
    requestAnimationFrame(() => { isAsked = false; evaluate(); });
  };

  // Sliders. A number outside the range of its slider is kept, and the slider stays at its end.
  const rows = [];
  const addSlider = (parent, row) => {
    const [low, high] = row.range, id = `value-${rows.length}`;
    const slider = htmlElement("input", { type: "range", id, min: low, max: high, step: (high - low) / 200 });
    const unit = row.unit ? ` in ${row.unit}` : "";
    const number = htmlElement("input", { type: "number", step: "any", "aria-label": `${row.name}, number${unit}` });
    slider.setAttribute("aria-label", `${row.name}${unit}`);
    const label = htmlElement("label", { for: id }, htmlElement("span", { class: "name" }, row.name));
    if (row.doc) label.append(htmlElement("span", { class: "doc" }, row.doc));
    const line = htmlElement("div", { class: "row" }, label, slider, number, htmlElement("span", { class: "unit" }, row.unit));
    const own = { ...row, show: () => { const v = row.get(); slider.value = v; number.value = Number(v.toPrecision(12)); line.classList.toggle("changed", v !== row.value); } };
    if (row.refusal) {
      slider.disabled = number.disabled = true;
      line.append(htmlElement("p", { class: "hint" }, row.refusal));
    }
    const change = (value) => { row.put(value); own.show(); run(); };
    let waiting = 0;
    const hold = () => {
      clearTimeout(waiting);
      if (!result || (held && held.name === row.name)) return;
      held = { name: row.name, before: row.get(), base: result, value: row.get, sensitivity: row.sensitivity, isMoved: false };
    };
    const release = () => { if (held && held.name === row.name) { held = null; drawCharts(); } };
    slider.addEventListener("pointerdown", hold);
    slider.addEventListener("input", () => {
      hold();
      if (held) held.isMoved = true;
      change(Number(slider.value));
    });
    for (const kind of ["pointerup", "pointercancel", "blur"]) slider.addEventListener(kind, release);
    // Keys do not hold a slider, so the prediction stays for a while.
    slider.addEventListener("keyup", () => { clearTimeout(waiting); waiting = setTimeout(release, 1500); });
    number.addEventListener("change", () => {
      const value = Number(number.value);
      if (number.value.trim() === "" || !Number.isFinite(value)) own.show();
      else change(value);
    });
    own.show();
    rows.push(own);
    parent.append(line);
  };
  const sensitivityTo = (key, i) => data.sensitivities.findIndex((row) => row[key] === i);
  data.parameters.forEach((row, i) => addSlider(element("parameters"), {
    ...row, get: () => parameters[i], put: (value) => { parameters[i] = value; }, sensitivity: sensitivityTo("parameter", i),
    refusal: row.held ? "Times of events, or the start, were computed for this value: change it in the scene." : "",
  }));
  data.states.forEach((row, i) => {
    if (row.set) addSlider(element("initial"), {
      ...row, doc: "", get: () => (initial.has(i) ? initial.get(i) : row.value),
      put: (value) => { initial.set(i, value); }, sensitivity: sensitivityTo("state", i), refusal: "",
    });
  });
  element("initial-group").hidden = !element("initial").childElementCount;

  element("end").value = tEnd;
  element("end").addEventListener("change", () => {
    const value = Number(element("end").value);
    if (value > 0 && Number.isFinite(value)) tEnd = value;
    element("end").value = tEnd;
    run();
  });
  data.methods.forEach((name, i) => element("method").append(htmlElement("option", { value: i }, name)));
  element("method-row").hidden = data.methods.length < 2;
  element("method").addEventListener("change", () => { method = Number(element("method").value); run(); });
  const addChoice = (value, text) => element("quantity").append(htmlElement("option", { value }, text));
  addChoice(-1, "values");
  data.sensitivities.forEach((row, i) => addChoice(i, `sensitivities to ${row.name}`));
  element("quantity").parentElement.hidden = !data.sensitivities.length;
  element("quantity").addEventListener("change", () => { along = Number(element("quantity").value); layOutCharts(); });
  for (const row of quantities) {
    const box = htmlElement("input", { type: "checkbox" });
    box.checked = shown.has(row.id);
    box.addEventListener("change", () => { shown[box.checked ? "add" : "delete"](row.id); layOutCharts(); });
    element("choices").append(htmlElement("label", {}, box, row.unit ? `${row.name} [${row.unit}]` : row.name));
  }
  if (element("cursor")) element("cursor").addEventListener("input", () => setTime(Number(element("cursor").value) * tEnd, false));

  element("undo").addEventListener("click", () => {
    data.parameters.forEach((row, i) => { parameters[i] = row.value; });
    initial.clear();
    tEnd = data.t_end;
    element("end").value = tEnd;
    for (const row of rows) row.show();
    run();
  });
  const download = (text, kind, suffix) => {
    const link = htmlElement("a", { download: `${data.name.replace(/[^\w.-]+/g, "_")}${suffix}` });
    link.href = URL.createObjectURL(new Blob([text], { type: kind }));
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  // The columns of result.to_csv in Python.
  const csvText = () => {
    const own = quantities.filter((row) => row.kind === "x"), outputs = quantities.filter((row) => row.kind === "o");
    const columns = [["t", result.t]];
    for (const row of [...own, ...outputs, ...quantities.filter((r) => r.kind === "u")]) columns.push([row.name, result.values(row.kind, row.i)]);
    for (const row of [...own, ...outputs]) {
      data.sensitivities.forEach((p, j) => columns.push([`d(${row.name})/d(${p.name})`, result.slopes(row.kind, row.i, j)]));
    }
    const lines = [columns.map(([name]) => name).join(",")];
    for (let k = 0; k < result.n; k++) lines.push(columns.map(([, values]) => values[k]).join(","));
    return `${lines.join("\n")}\n`;
  };
  const tomlText = () => {
    const number = (v) => (Number.isInteger(v) && Math.abs(v) < 1e15 ? v.toFixed(1) : String(v));
    const written = new Set();
    const text = data.scene.map((part) => {
      if (typeof part === "string") return part;
      const isParameter = "p" in part, i = isParameter ? part.p : part.x;
      written.add(isParameter ? data.parameters[i].name : data.states[i].name);
      return number(isParameter ? parameters[i] : initial.has(i) ? initial.get(i) : data.states[i].value);
    }).join("");
    // Values of parts, and initial values that the scene does not contain as numbers.
    const left = rows.filter((row) => row.get() !== row.value && !written.has(row.name)).map((row) => `# not in this file: ${row.name} = ${number(row.get())}\n`);
    return left.join("") + text;
  };
  element("csv").addEventListener("click", () => result && download(csvText(), "text/csv", ".csv"));
  element("toml").addEventListener("click", () => download(tomlText(), "application/toml", ".toml"));

  document.querySelectorAll("#graphs figure").forEach((figure, i) => drawLinearGraph(data.graphs[i], figure.querySelector("svg"), figure.querySelector(".hint")));

  try {
    engine = await loadEngine(data);
    if (data.motion) {
      const dark = window.matchMedia("(prefers-color-scheme: dark)");
      data.motion.duration = data.motion.pause * Math.max(1, data.motion.frames - 1);
      viewer = createViewer(data.motion, {
        keyboard: element("motion"), isStill: true,
        background: () => (dark.matches ? [0.11, 0.12, 0.14] : [0.98, 0.98, 0.973]),
        onTime: (t) => setTime(t, false),
      });
      dark.addEventListener("change", () => viewer && viewer.redraw());
    }
    result = engine.run({ parameters, initial, method, end: tEnd, points: data.points });
    layOutCharts();
    showRun();
  } catch (error) {
    showMessage(`The model cannot run in this browser: ${error.message}`);
  }
  new ResizeObserver(() => { for (const chart of charts) { chart.redraw(); chart.point(cursorTime); } }).observe(element("charts"));
  // For tests and for pages that embed this one.
  window.cotree = { data, result: () => result, evaluate, csvText, tomlText };
})();

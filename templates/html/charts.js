// Curves over time: one chart for each unit.
const svgElement = (tag, attributes = {}, text = "") => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text) made.textContent = text;
  return made;
};
const htmlElement = (tag, attributes = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
};

const formatNumber = (value, digits = 4) => {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) {
    return value.toExponential(digits - 1).replace(/\.?0+e/, "e").replace("e+", "e").replace("-", "−");
  }
  return String(Number(value.toPrecision(digits))).replace("-", "−");
};

// Round ticks between two values: multiples of 1, 2 or 5 times a power of ten.
const ticksBetween = (low, high, most) => {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((m) => m * power >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
};

const createChart = (unit, curves, onPoint) => {
  const margin = { left: 62, right: 14, top: 22, bottom: 36 };
  const svg = svgElement("svg", { class: "curves", role: "img" });
  const legend = htmlElement("ul", { class: "legend" });
  const root = htmlElement("figure", { class: "chart" }, legend, svg);
  const grid = svgElement("g", { class: "grid" }), lines = svgElement("g", { class: "lines" });
  const cursor = svgElement("line", { class: "cursor" });
  svg.append(grid, lines, cursor);
  const rows = curves.map((curve) => {
    const color = `color${curve.color}`;
    const paths = {};
    for (const kind of ["base", "predicted", "exact"]) {
      paths[kind] = svgElement("path", { class: `${kind} ${color}` });
      lines.append(paths[kind]);
    }
    const value = htmlElement("span", { class: "value" });
    legend.append(htmlElement("li", {}, htmlElement("span", { class: `swatch ${color}` }), curve.label, value));
    return { curve, paths, value };
  });
  let range = null, end = 1, size = { width: 600, height: 190 }, last = null;
  const x = (t) => margin.left + ((size.width - margin.left - margin.right) * t) / end;
  const y = (v) => size.height - margin.bottom - ((size.height - margin.top - margin.bottom) * (v - range[0])) / (range[1] - range[0]);

  const outline = (t, values) => {
    let text = "", isOpen = false;
    for (let i = 0; i < t.length; i++) {
      if (!Number.isFinite(values[i])) { isOpen = false; continue; }
      text += `${isOpen ? "L" : "M"}${x(t[i]).toFixed(1)} ${y(values[i]).toFixed(1)}`;
      isOpen = true;
    }
    return text;
  };
  // Include all curves; while a slider is held, keep the range unless a curve leaves it.
  const fit = (drawn, isHeld) => {
    let low = Infinity, high = -Infinity;
    for (const row of drawn) {
      for (const { values } of Object.values(row)) {
        for (const v of values) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
      }
    }
    if (low > high) [low, high] = [0, 1];
    const middle = 0.5 * (low + high), least = Math.max(1e-9 * Math.abs(middle), 1e-12);
    if (high - low < 2 * least) [low, high] = [middle - (Math.abs(middle) * 0.05 || 1), middle + (Math.abs(middle) * 0.05 || 1)];
    if (isHeld && range && low >= range[0] && high <= range[1] && high - low > 0.3 * (range[1] - range[0])) return;
    const pad = 0.06 * (high - low);
    range = [low - pad, high + pad];
  };
  const drawGrid = () => {
    const parts = [];
    for (const v of ticksBetween(range[0], range[1], size.height < 170 ? 5 : 6)) {
      parts.push(svgElement("line", { x1: margin.left, x2: size.width - margin.right, y1: y(v), y2: y(v) }));
      parts.push(svgElement("text", { x: margin.left - 7, y: y(v) + 4, "text-anchor": "end" }, formatNumber(v)));
    }
    for (const t of ticksBetween(0, end, size.width < 420 ? 4 : 8)) {
      parts.push(svgElement("line", { x1: x(t), x2: x(t), y1: margin.top, y2: size.height - margin.bottom }));
      parts.push(svgElement("text", { x: x(t), y: size.height - margin.bottom + 16, "text-anchor": "middle" }, formatNumber(t)));
    }
    parts.push(svgElement("text", { class: "unit", x: margin.left, y: 13, "text-anchor": "start" }, unit ? `[${unit}]` : "[1]"));
    parts.push(svgElement("text", { class: "unit", x: size.width - margin.right, y: size.height - 4, "text-anchor": "end" }, "t [s]"));
    grid.replaceChildren(...parts);
  };
  // Draw rows of { exact, base, predicted }, each with times `t` and `values`.
  const draw = (drawn, tEnd, isHeld) => {
    last = [drawn, tEnd, isHeld];
    end = tEnd;
    size = { width: Math.max(220, svg.clientWidth || 600), height: svg.clientHeight || 190 };
    svg.setAttribute("viewBox", `0 0 ${size.width} ${size.height}`);
    fit(drawn, isHeld);
    drawGrid();
    rows.forEach((row, i) => {
      for (const [kind, path] of Object.entries(row.paths)) {
        const line = drawn[i][kind];
        path.setAttribute("d", line ? outline(line.t, line.values) : "");
      }
    });
    svg.setAttribute("aria-label", `${curves.map((c) => c.label).join(", ")} over time from 0 to ${formatNumber(tEnd)} s`);
  };
  // Show the values at a time; null: at the end of the run.
  const point = (t) => {
    if (!last) return;
    const isShown = t !== null && t <= end;
    cursor.setAttribute("visibility", isShown ? "visible" : "hidden");
    if (isShown) {
      for (const [name, value] of [["x1", x(t)], ["x2", x(t)], ["y1", margin.top], ["y2", size.height - margin.bottom]]) cursor.setAttribute(name, value);
    }
    rows.forEach((row, i) => {
      const { t: times, values } = last[0][i].exact, n = times.length;
      if (!n) { row.value.textContent = ""; return; }
      let k = n - 1;
      if (isShown) { k = 0; while (k + 1 < n && times[k + 1] <= t) k++; }
      const next = Math.min(k + 1, n - 1), part = isShown && next > k ? (t - times[k]) / (times[next] - times[k]) : 0;
      row.value.textContent = formatNumber(values[k] + (values[next] - values[k]) * part);
      row.value.dataset.value = values[k] + (values[next] - values[k]) * part;
    });
  };
  const timeOf = (event) => {
    const box = svg.getBoundingClientRect();
    const t = ((event.clientX - box.left - margin.left) / (size.width - margin.left - margin.right)) * end;
    return t >= 0 && t <= end ? t : null;
  };
  svg.addEventListener("pointermove", (event) => onPoint(timeOf(event), event.buttons === 1));
  svg.addEventListener("pointerdown", (event) => onPoint(timeOf(event), true));
  svg.addEventListener("pointerleave", () => onPoint(null, false));
  return { root, draw, point, redraw: () => last && draw(...last) };
};

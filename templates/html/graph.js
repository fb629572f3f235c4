// A linear graph: pointing at an edge or focusing it highlights its f-cutset or f-circuit.
const drawLinearGraph = (graph, svg, note) => {
  const unit = 104; // pixels of a unit of the layout, whose names have letters of 0.07 units
  const at = ([x, y]) => [x * unit, -y * unit];
  const rest = note.textContent;
  const cubic = (points, s) => [0, 1].map((k) => {
    const r = 1 - s;
    return r * r * r * points[0][k] + 3 * r * r * s * points[1][k] + 3 * r * s * s * points[2][k] + s * s * s * points[3][k];
  });
  const groups = new Map();
  const sum = (edge) => Object.entries(edge.terms).map(([name, sign], i) => {
    const mark = sign < 0 ? (i ? " − " : "−") : i ? " + " : "";
    return mark + name;
  }).join("");
  const explain = (edge) => (edge.branch
    ? `f-cutset of branch ${edge.name} (${edge.kind}): ${sum(edge)} = 0, a sum of through variables`
    : `f-circuit of chord ${edge.name} (${edge.kind}): ${sum(edge)} = 0, a sum of across variables`);
  const pick = (edge) => {
    svg.classList.toggle("picked", edge !== null);
    for (const [name, group] of groups) {
      group.classList.toggle("within", edge !== null && name in edge.terms);
      group.classList.toggle("against", edge !== null && edge.terms[name] < 0);
      group.classList.toggle("own", edge !== null && name === edge.name);
    }
    note.textContent = edge ? explain(edge) : rest;
  };
  for (const edge of graph.edges) {
    const points = edge.points.map(at);
    const [p, a, b, q] = points.map((v) => v.map((c) => c.toFixed(1)).join(" "));
    const group = svgElement("g", { class: `edge ${edge.branch ? "branch" : "chord"}`, tabindex: 0, role: "button",
      "aria-label": `${edge.name}, ${edge.kind}, ${edge.branch ? "branch" : "chord"} from ${edge.tail} to ${edge.head}` });
    const d = `M${p}C${a} ${b} ${q}`;
    const tip = cubic(points, 0.76), tail = cubic(points, 0.7);
    const angle = Math.atan2(tip[1] - tail[1], tip[0] - tail[0]);
    const corner = (along, across) => [tip[0] + along * Math.cos(angle) - across * Math.sin(angle), tip[1] + along * Math.sin(angle) + across * Math.cos(angle)].map((v) => v.toFixed(1)).join(",");
    const [x, y] = at(edge.label);
    group.append(svgElement("path", { class: "target", d }), svgElement("path", { class: "line", d }),
      svgElement("polygon", { points: [corner(5, 0), corner(-7, 5.5), corner(-7, -5.5)].join(" ") }),
      svgElement("text", { x, y: y + 5, "text-anchor": "middle" }, edge.name));
    for (const kind of ["pointerenter", "focus"]) group.addEventListener(kind, () => pick(edge));
    for (const kind of ["pointerleave", "blur"]) group.addEventListener(kind, () => pick(null));
    groups.set(edge.name, group);
    svg.append(group);
  }
  for (const node of graph.nodes) {
    const [x, y] = at(node.at), [dx, dy] = [node.away[0], -node.away[1]];
    const group = svgElement("g", { class: "node" });
    let distance = 20;
    if (node.name === graph.reference) { // a ground symbol
      const [gx, gy] = [x + 14 * dx, y + 14 * dy], strokes = [`M${x} ${y}L${gx} ${gy}M${gx - 20 * dy} ${gy + 20 * dx}L${gx + 20 * dy} ${gy - 20 * dx}`];
      for (let k = -18; k <= 18; k += 9) {
        const [hx, hy] = [gx - k * dy, gy + k * dx];
        strokes.push(`M${hx} ${hy}L${hx + 8 * dx + 5 * dy} ${hy + 8 * dy - 5 * dx}`);
      }
      group.append(svgElement("path", { class: "ground", d: strokes.join("") }));
      distance = Math.abs(dx) > 0.5 ? 56 : 40;
    }
    const isAside = Math.abs(dx) > 0.4 && node.name !== graph.reference;
    group.append(svgElement("circle", { cx: x, cy: y, r: 5 }),
      svgElement("text", {
        x: x + (isAside ? 11 * Math.sign(dx) : distance * dx), y: y + distance * dy + 5,
        "text-anchor": isAside ? (dx > 0 ? "start" : "end") : "middle",
      }, node.name));
    svg.append(group);
  }
  // Names may extend beyond the edges.
  const box = svg.getBBox(), pad = 6;
  svg.setAttribute("viewBox", [box.x - pad, box.y - pad, box.width + 2 * pad, box.height + 2 * pad].map(Math.round).join(" "));
  svg.style.maxWidth = `${Math.round(box.width + 2 * pad)}px`;
};


"use strict";
// Show an animation in the elements of page.html.jinja or model.html.jinja. Options: the element that
// receives keys, the colour behind the mechanism, and a function that is called with the time shown.
const createViewer = (data, options = {}) => {
  const keyboard = options.keyboard || document;
  const element = (name) => document.getElementById(name);
  const canvas = element("scene"), slider = element("slider");
  const gl = canvas.getContext("webgl", { antialias: true });
  if (!gl) {
    element("note").textContent = "This browser does not support WebGL, which the animation requires.";
    return null;
  }

  // Vectors, matrices by columns, quaternions with the scalar first.
  const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const scale = (s, a) => [s * a[0], s * a[1], s * a[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => scale(1 / (Math.hypot(...a) || 1), a);
  const axesOf = ([w, x, y, z]) => [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
  const along = (axes, a) => add(add(scale(a[0], axes[0]), scale(a[1], axes[1])), scale(a[2], axes[2]));
  const matrix = (axes, at) => new Float32Array([...axes[0], 0, ...axes[1], 0, ...axes[2], 0, ...at, 1]);

  // Decode numbers that are stored as integer differences between rows of n numbers.
  const decodeDifferences = (rows, n, factor) => {
    const out = new Float64Array(rows.length);
    for (let i = 0; i < rows.length; i++) out[i] = rows[i] + (i < n ? 0 : out[i - n]);
    return out.map((v) => v * factor);
  };
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  let tracks = data.tracks.map((row) => ({
    p: decodeDifferences(row.p || [0, 0, 0], 3, data.unit), q: decodeDifferences(row.q || [1, 0, 0, 0], 4, data.turn),
  }));
  let centres = decodeDifferences(data.centres, 3, data.unit);
  let last = data.frames - 1, growth = 1;

  // Interpolate a row of n numbers at the fractional frame f.
  const row = (values, n, f) => {
    if (values.length === n) return Array.from(values);
    const i = Math.min(Math.floor(f), last - 1), x = f - i, out = [];
    for (let k = 0; k < n; k++) out.push(values[i * n + k] * (1 - x) + values[(i + 1) * n + k] * x);
    return out;
  };
  const poseAt = (track, f) => {
    const q = row(track.q, 4, f), size = Math.hypot(...q) || 1;
    return { at: row(track.p, 3, f), axes: axesOf(q.map((v) => v / size)) };
  };

  // Vertices of all triangles, with the mean normal of adjacent faces that are nearly parallel.
  const triangleVertices = (mesh) => {
    const u = new Uint16Array(bytes(mesh.points)), raw = bytes(mesh.faces);
    const faces = mesh.wide ? new Uint32Array(raw) : new Uint16Array(raw);
    const point = (i) => [0, 1, 2].map((k) => mesh.low[k] + (mesh.span[k] * u[3 * i + k]) / 65535);
    const n = faces.length / 3, normals = [], around = new Map();
    for (let f = 0; f < n; f++) {
      const [a, b, c] = [point(faces[3 * f]), point(faces[3 * f + 1]), point(faces[3 * f + 2])];
      normals.push(cross(sub(b, a), sub(c, a)));
      for (let k = 0; k < 3; k++) {
        const i = faces[3 * f + k];
        if (!around.has(i)) around.set(i, []);
        around.get(i).push(f);
      }
    }
    const units = normals.map(unit), places = [], outwards = [];
    for (let f = 0; f < n; f++) {
      for (let k = 0; k < 3; k++) {
        const i = faces[3 * f + k];
        let sum = [0, 0, 0];
        for (const g of around.get(i)) if (dot(units[f], units[g]) > 0.8) sum = add(sum, normals[g]);
        places.push(...point(i));
        outwards.push(...unit(sum));
      }
    }
    return { places, outwards };
  };

  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 place, outwards, color;
    uniform mat4 body, view;
    varying vec3 vNormal, vColor;
    uniform mat3 look;
    uniform float stretch;
    void main() {
      // Normals scale with the inverse of the stretch.
      vec3 n = vec3(outwards.xy, outwards.z / stretch);
      vNormal = look * mat3(body) * vec3(n.xy, n.z / stretch);
      vColor = color;
      gl_Position = view * (body * vec4(place, 1.0));
    }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float;
    varying vec3 vNormal, vColor;
    uniform float flatly;
    void main() {
      vec3 n = normalize(vNormal);
      if (n.z < 0.0) n = -n;
      float lit = clamp(dot(n, normalize(vec3(-0.35, 0.55, 0.76))), 0.0, 1.0);
      gl_FragColor = vec4(vColor * mix(0.62 + 0.38 * lit, 1.0, flatly), 1.0);
    }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const place = (name) => gl.getUniformLocation(program, name);
  const where = { body: place("body"), view: place("view"), look: place("look"), stretch: place("stretch"), flatly: place("flatly") };
  const names = ["place", "outwards", "color"];
  const slots = names.map((name) => gl.getAttribLocation(program, name));
  slots.forEach((slot) => gl.enableVertexAttribArray(slot));
  const upload = (places, outwards, colors) => ({
    n: places.length / 3,
    buffers: [places, outwards, colors].map((values) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
      return buffer;
    }),
  });
  const coloredVertices = (part) => {
    const { places, outwards } = triangleVertices(part.mesh), colors = [];
    for (let i = 0; i < places.length; i += 3) colors.push(...part.color.map((c) => c / 255));
    return { places, outwards, colors };
  };
  const draw = (part, kind) => {
    part.buffers.forEach((buffer, i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(slots[i], 3, gl.FLOAT, false, 0, 0);
    });
    gl.drawArrays(kind, 0, part.n);
  };

  const bodies = tracks.map((_, i) => {
    const all = { places: [], outwards: [], colors: [] };
    for (const solid of data.solids.filter((s) => s.track === i)) {
      const own = coloredVertices(solid);
      for (const key of Object.keys(all)) all[key] = all[key].concat(own[key]);
    }
    return upload(all.places, all.outwards, all.colors);
  });
  const struts = data.struts.map((strut) => {
    const own = coloredVertices(strut);
    return { ...strut, shape: upload(own.places, own.outwards, own.colors) };
  });
  const floor = upload(data.floor, data.floor.map(() => 0), data.floor.map(() => 0.865));

  // Camera: rotation about the upward axis, elevation, translation and zoom.
  const start = { turn: 0, raise: Math.asin(Math.max(-1, Math.min(1, dot(data.towards, data.up)))), move: [0, 0], zoom: 1 };
  const level = unit(sub(data.towards, scale(dot(data.towards, data.up), data.up)));
  let eye = { ...start };
  const camera = (f) => {
    const width = canvas.clientWidth, height = canvas.clientHeight, aspect = width / height;
    const side = cross(data.up, level);
    const ahead = add(scale(Math.cos(eye.turn), level), scale(Math.sin(eye.turn), side));
    const z = add(scale(Math.cos(eye.raise), ahead), scale(Math.sin(eye.raise), data.up));
    const x = unit(cross(data.up, ahead)), y = cross(z, x);
    const [right, above, depth] = data.reach.map((v) => growth * v);
    const slope = Math.tan((13 * Math.PI) / 180);
    const fit = data.margin * (Math.max(above, right / aspect) || 1);
    const distance = (data.flat ? 20 * Math.max(fit, right, depth) : fit / slope + depth) / (data.flat ? 1 : eye.zoom);
    const half = data.flat ? fit / eye.zoom : slope * distance;
    const middle = sub(row(centres, 3, f), add(scale(eye.move[0], x), scale(eye.move[1], y)));
    return { x, y, z, middle, half, aspect, distance, width, height };
  };
  const viewOf = (c) => {
    const far = data.flat ? 2 * c.distance : c.distance + 20 * data.extent, near = data.flat ? 0 : 0.02 * c.distance;
    const from = add(c.middle, scale(c.distance, c.z));
    const t = [-dot(c.x, from), -dot(c.y, from), -dot(c.z, from)];
    const w = 1 / (c.half * c.aspect), h = 1 / c.half;
    const [a, b] = data.flat ? [-2 / (far - near), -(far + near) / (far - near)]
      : [-(far + near) / (far - near), (-2 * far * near) / (far - near)];
    const k = data.flat ? 1 : c.distance;
    const rows = [[c.x, w * k, t[0]], [c.y, h * k, t[1]], [c.z, a, t[2]]];
    const out = new Float32Array(16);
    rows.forEach(([axis, factor, shift], i) => {
      for (let j = 0; j < 3; j++) out[4 * j + i] = factor * axis[j];
      out[12 + i] = factor * shift;
    });
    out[14] += b;
    if (data.flat) out[15] = 1;
    else {
      for (let j = 0; j < 3; j++) out[4 * j + 3] = -c.z[j];
      out[15] = -t[2];
    }
    return out;
  };

  const labels = data.labels.map((label) => {
    const span = document.createElement("span");
    span.textContent = label.text;
    return { ...label, span };
  });
  const showNames = (c, view, poses) => {
    for (const label of labels) {
      const pose = poses[label.track], p = add(pose.at, along(pose.axes, label.at));
      const out = [0, 1, 3].map((i) => view[i] * p[0] + view[4 + i] * p[1] + view[8 + i] * p[2] + view[12 + i]);
      const x = (0.5 + (0.5 * out[0]) / out[2]) * c.width, y = (0.5 - (0.5 * out[1]) / out[2]) * c.height;
      label.span.style.transform = `translate(${x + 8}px, ${y - 20}px)`;
      label.span.style.visibility = out[2] > 0 ? "visible" : "hidden";
    }
  };

  const state = { frame: 0, isPlaying: false, speed: 1, names: false };
  const digits = data.digits;
  const timeAt = (f) => data.start + f * data.step;
  const render = () => {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(...(options.background ? options.background() : [250 / 255, 250 / 255, 248 / 255]), 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const f = state.frame, c = camera(f), view = viewOf(c), poses = tracks.map((t) => poseAt(t, f));
    gl.uniformMatrix4fv(where.view, false, view);
    gl.uniformMatrix3fv(where.look, false, new Float32Array([0, 1, 2].flatMap((j) => [c.x[j], c.y[j], c.z[j]])));
    gl.uniform1f(where.stretch, 1);
    gl.uniform1f(where.flatly, 1);
    gl.uniformMatrix4fv(where.body, false, matrix([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0]));
    draw(floor, gl.LINES);
    gl.uniform1f(where.flatly, 0);
    bodies.forEach((body, i) => {
      gl.uniformMatrix4fv(where.body, false, matrix(poses[i].axes, poses[i].at));
      draw(body, gl.TRIANGLES);
    });
    for (const strut of struts) {
      const [a, b] = [0, 1].map((k) => {
        const pose = poses[strut.tracks[k]];
        return add(pose.at, along(pose.axes, strut.ends[k]));
      });
      const gap = sub(b, a), length = Math.hypot(...gap);
      if (!length) continue;
      const z = scale(1 / length, gap);
      let x = cross(along(poses[strut.tracks[0]].axes, strut.side), z);
      if (Math.hypot(...x) < 1e-6) x = cross(Math.abs(z[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0], z);
      x = unit(x);
      gl.uniform1f(where.stretch, length);
      gl.uniformMatrix4fv(where.body, false, matrix([x, cross(z, x), gap], a));
      draw(strut.shape, gl.TRIANGLES);
    }
    if (state.names) showNames(c, view, poses);
    slider.value = f;
    if (options.onTime) options.onTime(timeAt(f));
    element("time").textContent = `${timeAt(f).toFixed(digits)} / ${timeAt(last).toFixed(digits)} s`;
  };

  // Advance the frame during playback; pause at the end, then restart.
  let before = 0, waiting = 0, isAsked = false;
  const tick = (now) => {
    isAsked = false;
    // The timestamp of a frame may be earlier than the click that requested it.
    const passed = Math.max(0, Math.min(0.1, (now - before) / 1000));
    before = now;
    if (state.isPlaying) {
      if (state.frame >= last) {
        waiting += passed;
        if (waiting > 0.7) state.frame = waiting = 0;
      } else state.frame = Math.min(last, state.frame + (passed * state.speed) / data.pause);
    }
    render();
    if (state.isPlaying) ask();
  };
  const ask = () => {
    if (isAsked) return;
    isAsked = true;
    requestAnimationFrame(tick);
  };
  const play = (wanted) => {
    state.isPlaying = wanted && last > 0;
    if (state.isPlaying && state.frame >= last) state.frame = 0;
    waiting = 0;
    before = performance.now();
    element("play").textContent = state.isPlaying ? "Pause" : "Play";
    ask();
  };
  const seek = (f) => {
    play(false);
    state.frame = Math.max(0, Math.min(last, f));
    ask();
  };
  const changeSpeed = (by) => {
    const choice = element("speed");
    choice.selectedIndex = Math.max(0, Math.min(choice.options.length - 1, choice.selectedIndex + by));
    state.speed = Number(choice.value);
  };
  const toggleNames = () => {
    state.names = !state.names;
    element("label").setAttribute("aria-pressed", state.names);
    element("names").replaceChildren(...(state.names ? labels.map((l) => l.span) : []));
    ask();
  };
  const reset = () => { eye = { ...start, move: [0, 0] }; ask(); };
  // Zoom about the pointer, or about the centre of the view.
  const zoom = (factor, at) => {
    const near = () => { const c = camera(state.frame); return (2 * c.half) / c.height; };
    const old = near();
    eye.zoom = Math.max(0.05, Math.min(200, eye.zoom * factor));
    const box = canvas.getBoundingClientRect(), lost = old - near();
    if (at) {
      const [x, y] = [at[0] - box.left - 0.5 * box.width, 0.5 * box.height - at[1] + box.top];
      eye.move = [eye.move[0] - lost * x, eye.move[1] - lost * y];
    }
    ask();
  };

  element("play").addEventListener("click", () => play(!state.isPlaying));
  element("label").addEventListener("click", toggleNames);
  element("reset").addEventListener("click", reset);
  element("speed").addEventListener("change", () => changeSpeed(0));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  keyboard.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const isControl = ["BUTTON", "SELECT"].includes(event.target.tagName);
    const actions = {
      " ": isControl ? null : () => play(!state.isPlaying),
      ArrowLeft: () => seek(Math.ceil(state.frame) - 1), ArrowRight: () => seek(Math.floor(state.frame) + 1),
      Home: () => seek(0), End: () => seek(last), n: toggleNames, r: reset,
      "[": () => changeSpeed(-1), "]": () => changeSpeed(1), "+": () => zoom(1.25), "-": () => zoom(0.8),
    };
    if (!actions[event.key] || (event.target.tagName === "SELECT" && event.key.startsWith("Arrow"))) return;
    event.preventDefault();
    actions[event.key]();
  });

  // Dragging rotates a spatial scene and pans a planar one; with shift or the right button, vice versa.
  // Two fingers pan and zoom.
  const fingers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.classList.add("busy");
  });
  const release = (event) => { fingers.delete(event.pointerId); canvas.classList.toggle("busy", fingers.size > 0); };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointermove", (event) => {
    const old = fingers.get(event.pointerId);
    if (!old) return;
    const dx = event.clientX - old[0], dy = event.clientY - old[1];
    const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]) || 1; };
    const apart = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (apart) zoom(spread() / apart);
    const isOther = event.shiftKey || (event.buttons & 2) !== 0;
    if (fingers.size === 2 || isOther !== data.flat) {
      const c = camera(state.frame), pixel = (2 * c.half) / c.height / fingers.size;
      eye.move = [eye.move[0] + dx * pixel, eye.move[1] - dy * pixel];
    } else {
      eye.turn -= dx * 0.008;
      eye.raise = Math.max(-1.57, Math.min(1.57, eye.raise + dy * 0.008));
    }
    ask();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode === 1 ? 20 : 1)), [event.clientX, event.clientY]);
  }, { passive: false });
  canvas.addEventListener("dblclick", reset);
  window.addEventListener("resize", ask);
  if (options.isStill) ask();
  else play(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  // Replace the motion: positions and quaternions of the tracks, evenly spaced times, and the size
  // of the mechanism relative to the size for which the camera was placed.
  const setMotion = (poses, middle, times, size) => {
    growth = size;
    const share = last > 0 ? state.frame / last : 0;
    tracks = poses;
    centres = middle;
    last = times.length - 1;
    data.start = times[0];
    data.step = last > 0 ? (times[last] - times[0]) / last : 0;
    data.pause = data.duration / Math.max(1, last);
    slider.max = last;
    state.frame = share * last;
    ask();
  };
  const seekTime = (t) => seek(data.step ? (t - data.start) / data.step : 0);
  return { setMotion, seekTime, redraw: ask, isPlaying: () => state.isPlaying };
};

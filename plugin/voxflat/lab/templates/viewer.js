// Draws a flat map and its surface side by side with WebGL. The user chooses a layer, rotates the surface, and reads
// the values under the pointer. Two meshes of 20,000 points need no library.
"use strict";

const CUT_COLOURS = ["#e6550d", "#3182bd", "#31a354", "#d6409f", "#8c6bd8", "#c9a400", "#00a5a5", "#a0522d"];
const SHADERS = [
  `attribute vec3 place; attribute vec3 normal; attribute vec3 colour; uniform mat4 view; uniform vec3 away;
   varying vec3 shade; varying float facing;
   void main() {
     gl_Position = view * vec4(place, 1.0);
     facing = -dot(normalize(normal + 1e-9), away);
     shade = colour; gl_PointSize = 9.0;
   }`,
  `precision mediump float; varying vec3 shade; varying float facing; uniform float lit;
   void main() {
     float light = facing > 0.0 ? 0.45 + 0.6 * facing : 0.35 + 0.25 * -facing;
     vec3 colour = facing > 0.0 ? shade : vec3(0.5); // the inside shows no values
     gl_FragColor = vec4(mix(shade, colour * light, lit), 1.0);
   }`,
];

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

function rgb(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
}

class Canvas {
  constructor(element) {
    this.element = element;
    const gl = (this.gl = element.getContext("webgl", { antialias: true, preserveDrawingBuffer: true }));
    if (!gl) throw new Error("WebGL is not available");
    gl.getExtension("OES_element_index_uint");
    this.program = gl.createProgram();
    [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, n) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, SHADERS[n]);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    });
    gl.linkProgram(this.program);
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    this.buffers = {};
  }

  attribute(name, values) {
    const gl = this.gl, at = gl.getAttribLocation(this.program, name);
    this.buffers[name] ??= gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    if (at < 0) return;
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
  }

  begin(view, away) {
    const gl = this.gl, ratio = window.devicePixelRatio || 1;
    const width = Math.round(this.element.clientWidth * ratio), height = Math.round(this.element.clientHeight * ratio);
    if (this.element.width !== width || this.element.height !== height) {
      this.element.width = width;
      this.element.height = height;
    }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(gl.getUniformLocation(this.program, "view"), false, view);
    gl.uniform3fv(gl.getUniformLocation(this.program, "away"), away);
  }

  draw(kind, indices, lit) {
    const gl = this.gl;
    gl.uniform1f(gl.getUniformLocation(this.program, "lit"), lit);
    this.indices ??= gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.DYNAMIC_DRAW);
    gl.drawElements(kind, indices.length, gl.UNSIGNED_INT, 0);
  }
}

class Viewer {
  constructor(root, content, buffer) {
    this.root = root;
    this.content = content;
    this.values = {};
    let at = 0;
    for (const { name, low, step, known, length } of content.arrays) {
      const coded = new Uint16Array(buffer, at, length);
      const value = known ? (code) => known[code] : (code) => low + step * code;
      this.values[name] = Float64Array.from(coded, (code) => (code === 65535 ? NaN : value(code)));
      at += 2 * length;
    }
    this.faces = new Uint32Array(buffer.slice(at, at + 12 * content.triangles));
    this.flat = new Canvas(root.querySelector("canvas.flat"));
    this.space = new Canvas(root.querySelector("canvas.space"));
    this.turn = content.view ?? [root.dataset.side === "right" ? Math.PI / 2 : -Math.PI / 2, 0.1]; // lateral: no inside is visible
    this.zoom = 1;
    this.marked = -1;
    this.places = new Float32Array(3 * content.points);
    this.flatPlaces = new Float32Array(3 * content.points);
    for (let n = 0; n < content.points; n++) this.flatPlaces.set(this.values.uv.subarray(2 * n, 2 * n + 2), 3 * n);
    this.flatNormals = this.flatPlaces.map((_, n) => Number(n % 3 === 2));
    this.lines = Object.values(content.cuts).map((line) => [line]);
    this.cutSides = this.sidesOfCuts();
    this.layer(0);
    this.smooth(Number(root.querySelector("input[type=range]").value));
    this.listen();
    new ResizeObserver(() => this.draw()).observe(root);
  }

  layer(number) {
    const { name, limits, labelled, colours } = this.content.layers[number];
    const [low, high] = limits, last = colours.length / 3 - 1, values = this.values[name];
    const known = labelled && this.content.arrays.find((array) => array.name === name).known;
    const row = labelled && new Map(known.map((label, n) => [label, n]));
    this.colours = new Float32Array(3 * this.content.points).fill(0.62);
    values.forEach((value, n) => {
      if (Number.isNaN(value)) return;
      const at = 3 * (labelled ? row.get(value) : Math.round(last * Math.min(1, Math.max(0, (value - low) / (high - low)))));
      for (let k = 0; k < 3; k++) this.colours[3 * n + k] = colours[at + k] / 255;
    });
    this.root.querySelectorAll(".bar").forEach((bar, n) => (bar.hidden = n !== number));
    this.draw();
  }

  smooth(share) {
    const { folded, smooth } = this.values;
    for (let n = 0; n < this.places.length; n++) this.places[n] = (1 - share) * folded[n] + share * smooth[n];
    const p = this.places, normals = (this.normals = new Float32Array(p.length));
    for (let n = 0; n < this.faces.length; n += 3) {
      const [a, b, c] = [3 * this.faces[n], 3 * this.faces[n + 1], 3 * this.faces[n + 2]];
      const u = [0, 1, 2].map((k) => p[b + k] - p[a + k]), v = [0, 1, 2].map((k) => p[c + k] - p[a + k]);
      const across = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += across[k];
    }
    this.draw();
  }

  flatView() {
    const uv = this.values.uv, low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (let n = 0; n < uv.length; n++) {
      low[n % 2] = Math.min(low[n % 2], uv[n]);
      high[n % 2] = Math.max(high[n % 2], uv[n]);
    }
    const { clientWidth: width, clientHeight: height } = this.flat.element;
    const scale = 0.96 * Math.min(width / (high[0] - low[0]), height / (high[1] - low[1]));
    const x = (2 * scale) / width, y = (2 * scale) / height;
    return new Float32Array([x, 0, 0, 0, 0, y, 0, 0, 0, 0, -0.001, 0,
      (-x * (low[0] + high[0])) / 2, (-y * (low[1] + high[1])) / 2, 0, 1]);
  }

  axes() {
    // the view direction: along y (anterior), rotated about z (superior), then tilted to look from above
    const [around, tilt] = this.turn;
    const [ca, sa, ct, st] = [Math.cos(around), Math.sin(around), Math.cos(tilt), Math.sin(tilt)];
    return { right: [ca, sa, 0], up: [-sa * st, ca * st, ct], away: [-sa * ct, ca * ct, -st] };
  }

  spaceView() {
    const { right, up, away } = this.axes(), p = this.places, low = [Infinity, Infinity, Infinity], high = low.map((v) => -v);
    for (let n = 0; n < p.length; n++) {
      low[n % 3] = Math.min(low[n % 3], p[n]);
      high[n % 3] = Math.max(high[n % 3], p[n]);
    }
    const middle = low.map((v, k) => (v + high[k]) / 2);
    let farthest = 0;
    for (let n = 0; n < p.length; n += 3)
      farthest = Math.max(farthest, Math.hypot(p[n] - middle[0], p[n + 1] - middle[1], p[n + 2] - middle[2]));
    const size = 2 * farthest || 1; // fits at any rotation
    const { clientWidth: width, clientHeight: height } = this.space.element;
    const fit = (1.96 * this.zoom * Math.min(width, height)) / size, x = fit / width, y = fit / height, z = 0.5 / size;
    const at = (axis, scale) => -scale * (axis[0] * middle[0] + axis[1] * middle[1] + axis[2] * middle[2]);
    return new Float32Array([x * right[0], y * up[0], z * away[0], 0, x * right[1], y * up[1], z * away[1], 0,
      x * right[2], y * up[2], z * away[2], 0, at(right, x), at(up, y), at(away, z), 1]);
  }

  draw() {
    if (!this.normals) return;
    for (const [canvas, places, normals, view, lit, cuts] of [
      [this.flat, this.flatPlaces, this.flatNormals, this.flatView(), 0, this.cutSides],
      [this.space, this.places, this.normals, this.spaceView(), 1, this.lines],
    ]) {
      const gl = canvas.gl;
      canvas.begin(view, this.axes().away);
      canvas.attribute("place", places);
      canvas.attribute("normal", normals);
      canvas.attribute("colour", this.colours);
      canvas.draw(gl.TRIANGLES, this.faces, lit);
      this.drawCuts(canvas, places, normals, cuts);
      if (this.marked >= 0) {
        const mark = new Float32Array(this.colours.length);
        for (let n = 0; n < mark.length; n += 3) mark[n + 1] = 1;
        gl.disable(gl.DEPTH_TEST);
        canvas.attribute("place", places); // drawing the cuts replaced these buffers
        canvas.attribute("normal", normals);
        canvas.attribute("colour", mark);
        canvas.draw(gl.POINTS, new Uint32Array([this.marked]), 0);
        gl.enable(gl.DEPTH_TEST);
      }
    }
  }

  sidesOfCuts() {
    // boundary edges of the map whose ends lie on a cut: each side of a cut has its own points, at the same position
    const { folded } = this.values, place = (point) => folded.subarray(3 * point, 3 * point + 3).join();
    const border = new Map();
    this.faces.forEach((from, n) => {
      const to = this.faces[n % 3 === 2 ? n - 2 : n + 1], key = `${Math.min(from, to)} ${Math.max(from, to)}`;
      if (!border.delete(key)) border.set(key, [from, to]);
    });
    return Object.values(this.content.cuts).map((line) => {
      const places = new Set(line.map(place));
      return [...border.values()].filter((edge) => edge.every((point) => places.has(place(point))));
    });
  }

  drawCuts(canvas, places, normals, cuts) {
    // slightly above the surface, as ribbons, because WebGL draws lines only one pixel wide
    const wide = 0.9;
    cuts.forEach((lines, number) => {
      const colour = rgb(CUT_COLOURS[number % CUT_COLOURS.length]), corners = [], faces = [];
      for (const line of lines) line.forEach((point, n) => {
        const from = 3 * line[Math.max(0, n - 1)], to = 3 * line[Math.min(line.length - 1, n + 1)], at = 3 * point;
        const along = [0, 1, 2].map((k) => places[to + k] - places[from + k]);
        const out = [0, 1, 2].map((k) => normals[at + k]), length = Math.hypot(...out) || 1;
        const unit = out.map((v) => v / length);
        const side = [along[1] * unit[2] - along[2] * unit[1], along[2] * unit[0] - along[0] * unit[2],
          along[0] * unit[1] - along[1] * unit[0]];
        const breadth = Math.hypot(...side) || 1, last = corners.length / 3;
        for (const sign of [-1, 1])
          for (let k = 0; k < 3; k++) corners.push(places[at + k] + 0.8 * unit[k] + (sign * wide * side[k]) / breadth);
        if (n) faces.push(last - 2, last - 1, last, last, last - 1, last + 1);
      });
      canvas.attribute("place", new Float32Array(corners));
      canvas.attribute("normal", new Float32Array(corners.length));
      canvas.attribute("colour", new Float32Array(corners.length).map((_, n) => colour[n % 3]));
      canvas.draw(canvas.gl.TRIANGLES, new Uint32Array(faces), 0);
    });
  }

  nearest(canvas, places, view, event, within) {
    const box = canvas.element.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1, y = 1 - (2 * (event.clientY - box.top)) / box.height;
    let best = -1, least = Infinity;
    for (let n = 0; n < places.length; n += 3) {
      const of = (k) => view[k] * places[n] + view[4 + k] * places[n + 1] + view[8 + k] * places[n + 2] + view[12 + k];
      const apart = Math.hypot(((of(0) - x) * box.width) / 2, ((of(1) - y) * box.height) / 2);
      if (apart > within) continue;
      const rank = canvas === this.flat ? apart : apart + 400 * of(2); // prefer the point in front
      if (rank < least) [best, least] = [n / 3, rank];
    }
    return best;
  }

  show(point) {
    this.marked = point;
    const output = this.root.querySelector("output");
    if (point < 0) {
      output.textContent = "Point at the map or the surface to read values.";
    } else {
      const id = this.content.ids[point];
      const values = this.content.layers.map(({ name, title, unit }) => {
        const value = this.values[name][point];
        const shown = Number.isInteger(value) ? String(value) : value.toPrecision(3);
        return `${title}: ${Number.isNaN(value) ? "no value" : shown + (unit ? " " + unit : "")}`;
      });
      const place = [0, 1, 2].map((k) => this.values.folded[3 * point + k].toFixed(1)).join(", ");
      output.textContent = (id === undefined ? "" : `Vertex ${id}, `) + `at (${place})${this.content.unit && " " + this.content.unit}. ` + values.join(" · ");
    }
    this.draw();
  }

  goTo(place) {
    // show the point of the surface nearest to a position, and rotate the surface so that it faces the viewer
    const { folded } = this.values;
    let best = 0, least = Infinity;
    for (let n = 0; n < this.content.points; n++) {
      const apart = Math.hypot(...place.map((value, k) => folded[3 * n + k] - value));
      if (apart < least) [best, least] = [n, apart];
    }
    const out = [...this.normals.subarray(3 * best, 3 * best + 3)], length = Math.hypot(...out) || 1;
    this.turn = [Math.atan2(out[0], -out[1]), Math.asin(out[2] / length)];
    this.zoom = 1; // the whole surface is visible, at any zoom before
    this.show(best);
  }

  listen() {
    const select = this.root.querySelector("select"), slider = this.root.querySelector("input[type=range]");
    select.addEventListener("change", () => this.layer(select.selectedIndex));
    slider.addEventListener("input", () => this.smooth(Number(slider.value)));
    const flat = this.flat.element, space = this.space.element;
    flat.addEventListener("pointermove", (event) =>
      this.show(this.nearest(this.flat, this.flatPlaces, this.flatView(), event, 12)));
    let last = null;
    space.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      space.setPointerCapture(event.pointerId);
    });
    space.addEventListener("pointerup", () => (last = null));
    space.addEventListener("pointermove", (event) => {
      if (!last) return this.show(this.nearest(this.space, this.places, this.spaceView(), event, 8));
      this.turn[0] -= (event.clientX - last[0]) / 120;
      this.turn[1] = Math.max(-1.55, Math.min(1.55, this.turn[1] + (event.clientY - last[1]) / 120));
      last = [event.clientX, event.clientY];
      this.draw();
    });
    for (const canvas of [flat, space]) canvas.addEventListener("pointerleave", () => this.show(-1));
    space.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.max(0.5, Math.min(8, this.zoom * Math.exp(-event.deltaY / 600)));
      this.draw();
    }, { passive: false });
    for (const button of this.root.querySelectorAll("button")) {
      button.addEventListener("click", () => {
        this.turn = button.value.split(",").map(Number);
        this.draw();
      });
    }
  }
}

for (const root of document.querySelectorAll(".viewer")) {
  const content = JSON.parse(root.querySelector("script").textContent);
  unpacked(content.data)
    .then((buffer) => {
      root.hidden = false; // a hidden canvas has no size
      root.viewer = new Viewer(root, content, buffer);
    })
    .catch((reason) => {
      root.hidden = false;
      root.replaceChildren(Object.assign(document.createElement("p"), {
        className: "note", textContent: `This browser cannot draw the surface (${reason.message}). Open the page in a browser with WebGL.`,
      }));
    });
}

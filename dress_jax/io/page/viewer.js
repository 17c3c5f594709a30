// Orbit view of a few triangle meshes: WebGL 1, no library, no host.
// Markup: <div class="viewer" data-scene="ID"> around a picture, which stays where WebGL is missing.
(function () {
  "use strict";

  const VERTEX = `
    attribute vec3 position, normal;
    uniform mat4 view, projection;
    varying vec3 vNormal, vPlace;
    void main() {
      vec4 place = view * vec4(position, 1.0);
      vNormal = mat3(view[0].xyz, view[1].xyz, view[2].xyz) * normal;
      vPlace = place.xyz;
      gl_Position = projection * place;
    }`;
  const FRAGMENT = `
    precision mediump float;
    uniform vec3 color;
    varying vec3 vNormal, vPlace;
    void main() {
      vec3 n = normalize(vNormal);
      vec3 toEye = normalize(-vPlace);
      bool inside = dot(n, toEye) < 0.0;
      if (inside) n = -n;
      float diffuse = 0.5 + 0.5 * dot(n, normalize(vec3(-0.35, 0.55, 0.76)));
      float light = (0.34 + 0.72 * diffuse * sqrt(diffuse)) * (0.75 + 0.25 * max(dot(n, toEye), 0.0));
      gl_FragColor = vec4(color * light * (inside ? 0.75 : 1.0), 1.0);
    }`;

  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  // Positions are 16-bit steps of `step` metres from `origin`; indices 32-bit.
  function decode(mesh) {
    const steps = new Uint16Array(bytes(mesh.positions));
    const indices = new Uint32Array(bytes(mesh.indices));
    const positions = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) positions[i] = mesh.origin[i % 3] + mesh.step * steps[i];
    return { name: mesh.name, color: mesh.color, shown: mesh.shown, positions, indices,
             normals: normalsOf(positions, indices) };
  }

  function normalsOf(p, f) {
    const n = new Float32Array(p.length);
    for (let i = 0; i < f.length; i += 3) {
      const a = 3 * f[i], b = 3 * f[i + 1], c = 3 * f[i + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const k of [a, b, c]) { n[k] += x; n[k + 1] += y; n[k + 2] += z; }
    }
    for (let i = 0; i < n.length; i += 3) {
      const length = Math.hypot(n[i], n[i + 1], n[i + 2]) || 1;
      n[i] /= length; n[i + 1] /= length; n[i + 2] /= length;
    }
    return n;
  }

  function program(gl) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    return made;
  }

  function buffer(gl, kind, data) {
    const made = gl.createBuffer();
    gl.bindBuffer(kind, made);
    gl.bufferData(kind, data, gl.STATIC_DRAW);
    return made;
  }

  function extent(meshes) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const mesh of meshes)
      for (let i = 0; i < mesh.positions.length; i++) {
        low[i % 3] = Math.min(low[i % 3], mesh.positions[i]);
        high[i % 3] = Math.max(high[i % 3], mesh.positions[i]);
      }
    return { center: low.map((v, k) => 0.5 * (v + high[k])),
             size: Math.hypot(...low.map((v, k) => high[k] - v)) || 1 };
  }

  function start(box) {
    const scene = JSON.parse(document.getElementById(box.dataset.scene).textContent);
    const canvas = document.createElement("canvas");
    const gl = canvas.getContext("webgl", { antialias: true });
    if (!gl || !gl.getExtension("OES_element_index_uint")) return;
    const shader = program(gl);
    const meshes = scene.meshes.map(decode);
    const { center, size } = extent(meshes);
    for (const mesh of meshes) {
      mesh.positionBuffer = buffer(gl, gl.ARRAY_BUFFER, mesh.positions);
      mesh.normalBuffer = buffer(gl, gl.ARRAY_BUFFER, mesh.normals);
      mesh.indexBuffer = buffer(gl, gl.ELEMENT_ARRAY_BUFFER, mesh.indices);
    }
    const at = (name) => gl.getUniformLocation(shader, name);
    const places = { view: at("view"), projection: at("projection"), color: at("color") };
    const position = gl.getAttribLocation(shader, "position");
    const normal = gl.getAttribLocation(shader, "normal");
    const FIELD = 0.5;  // vertical field of view [rad]
    const home = () => ({ yaw: 0, pitch: 0.08, distance: 0.5 * size / Math.tan(0.5 * FIELD), x: 0, y: 0 });
    let eye = home(), waiting = false;

    function draw() {
      waiting = false;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
      gl.viewport(0, 0, width, height);
      gl.clearColor(1, 1, 1, 1);
      gl.enable(gl.DEPTH_TEST);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.useProgram(shader);
      const near = 0.02 * eye.distance, far = eye.distance + 2 * size, f = 1 / Math.tan(0.5 * FIELD);
      gl.uniformMatrix4fv(places.projection, false, [
        f * height / width, 0, 0, 0, 0, f, 0, 0,
        0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
      const cy = Math.cos(eye.yaw), sy = Math.sin(eye.yaw), cp = Math.cos(eye.pitch), sp = Math.sin(eye.pitch);
      const rows = [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]];
      const moved = rows.map((r) => -(r[0] * center[0] + r[1] * center[1] + r[2] * center[2]));
      gl.uniformMatrix4fv(places.view, false, [
        rows[0][0], rows[1][0], rows[2][0], 0, rows[0][1], rows[1][1], rows[2][1], 0,
        rows[0][2], rows[1][2], rows[2][2], 0,
        moved[0] + eye.x, moved[1] + eye.y, moved[2] - eye.distance, 1]);
      for (const mesh of meshes) {
        if (!mesh.shown) continue;
        gl.uniform3fv(places.color, mesh.color);
        for (const [slot, data] of [[position, mesh.positionBuffer], [normal, mesh.normalBuffer]]) {
          gl.bindBuffer(gl.ARRAY_BUFFER, data);
          gl.enableVertexAttribArray(slot);
          gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, 0);
        }
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.indexBuffer);
        gl.drawElements(gl.TRIANGLES, mesh.indices.length, gl.UNSIGNED_INT, 0);
      }
    }
    function redraw() { if (!waiting) { waiting = true; requestAnimationFrame(draw); } }
    function zoom(factor) { eye.distance = Math.min(Math.max(eye.distance * factor, 0.1 * size), 6 * size); redraw(); }

    const down = new Map();
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); down.set(e.pointerId, [e.clientX, e.clientY]); });
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (e) => down.delete(e.pointerId));
    canvas.addEventListener("pointermove", (e) => {
      const before = down.get(e.pointerId);
      if (!before) return;
      const dx = e.clientX - before[0], dy = e.clientY - before[1];
      const metre = 2 * eye.distance * Math.tan(0.5 * FIELD) / canvas.clientHeight;
      if (down.size === 2) {
        const other = [...down.entries()].find(([id]) => id !== e.pointerId)[1];
        const gap = (x, y) => Math.hypot(x - other[0], y - other[1]) || 1;
        zoom(gap(before[0], before[1]) / gap(e.clientX, e.clientY));
        eye.x += 0.5 * dx * metre; eye.y -= 0.5 * dy * metre;
      } else if (e.shiftKey || e.buttons === 2) {
        eye.x += dx * metre; eye.y -= dy * metre;
      } else {
        eye.yaw -= 0.01 * dx;
        eye.pitch = Math.min(Math.max(eye.pitch + 0.01 * dy, -1.5), 1.5);
      }
      down.set(e.pointerId, [e.clientX, e.clientY]);
      redraw();
    });
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(0.001 * e.deltaY)); }, { passive: false });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("dblclick", () => { eye = home(); redraw(); });
    window.addEventListener("resize", redraw);

    const bar = document.createElement("div");
    bar.className = "bar";
    for (const [text, yaw] of [["Front", 0], ["Left", 0.5 * Math.PI], ["Back", Math.PI], ["Right", -0.5 * Math.PI]]) {
      const button = document.createElement("button");
      button.type = "button"; button.textContent = text;
      button.addEventListener("click", () => { eye = home(); eye.yaw = yaw; redraw(); });
      bar.appendChild(button);
    }
    for (const mesh of meshes) {
      const label = document.createElement("label"), check = document.createElement("input");
      check.type = "checkbox"; check.checked = mesh.shown;
      check.addEventListener("change", () => { mesh.shown = check.checked; redraw(); });
      label.append(check, " " + mesh.name);
      bar.appendChild(label);
    }
    box.replaceChildren(canvas, bar);
    box.classList.add("live");
    draw();
  }

  for (const box of document.querySelectorAll(".viewer")) {
    try { start(box); } catch (error) { console.error(error); }
  }
})();

// The map: walls, path, robots, obstacles. A click sends the robot there, a drag sets the heading.
const DRAG_PX = 14; // a shorter drag is a click
const STEP = 0.1;
const TURN = Math.PI / 12;
const TRAIL = 3000;
const TRAIL_M = 0.04;

export class Plan extends EventTarget {
  constructor(canvas) {
    super();
    this.canvas = canvas;
    this.ctx = canvas.getContext("2d");
    this.view = null; // {x, y: of the middle, m; k: pixels per metre}
    this.follow = false;
    this.graphs = true;
    this.chosen = "";
    this.robots = new Map(); // by namespace: {still, parts, trail, grid}
    this.target = null; // {x, y, theta or null, state}
    this.fan = []; // paths of a rehearsal: {end, points, put}
    this.press = null;
    this.pointers = new Map();
    this.touched = false;
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (e) => this.#down(e));
    canvas.addEventListener("pointermove", (e) => this.#move(e));
    canvas.addEventListener("pointerup", (e) => this.#up(e));
    canvas.addEventListener("pointercancel", (e) => this.#cancel(e));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => this.#wheel(e), { passive: false });
    canvas.addEventListener("keydown", (e) => this.#key(e));
    this.colours();
  }

  colours() {
    const style = getComputedStyle(document.documentElement);
    this.c = Object.fromEntries(["floor", "outside", "wall", "grid", "ink", "soft", "path", "near", "stop", "accent", "good", "warn", "card", "line"].map((n) => [n, style.getPropertyValue("--" + n).trim()]));
    for (const robot of this.robots.values()) { this.#inflate(robot); this.#unsee(robot); }
    this.dirty();
  }

  hello(robots) {
    this.robots = new Map(Object.entries(robots).map(([name, still]) => [name, { still, parts: {}, trail: still.trail.slice() }]));
    for (const robot of this.robots.values()) this.#unsee(robot);
    this.dirty();
  }

  state(name, parts) {
    const robot = this.robots.get(name);
    if (!robot) return;
    Object.assign(robot.parts, parts);
    if (parts.grid !== undefined) this.#inflate(robot);
    const m = robot.parts.motion;
    if (parts.motion && m.x !== undefined) {
      const last = robot.trail.at(-1);
      if (!last || Math.abs(m.x - last[0]) + Math.abs(m.y - last[1]) >= TRAIL_M) {
        robot.trail.push([m.x, m.y, robot.parts.wheels?.obeyed ?? null]);
        if (robot.trail.length > TRAIL) robot.trail.shift();
      }
    }
    if (!this.view || !this.touched) this.fit();
    if (this.follow && name === this.chosen && m?.x !== undefined) Object.assign(this.view, { x: m.x, y: m.y });
    this.dirty();
  }

  choose(name) {
    this.chosen = name;
    this.target = null;
    this.dirty();
  }

  aim(target) {
    this.target = target;
    this.dirty();
  }

  fit() {
    const bounds = this.#bounds();
    const w = this.canvas.clientWidth || 1, h = this.canvas.clientHeight || 1;
    const [x1, y1, x2, y2] = bounds;
    const k = Math.min(Math.max(Math.min((w - 88) / (x2 - x1), (h - 100) / (y2 - y1)), 5), 400);
    // Left of the tools, and above the legend.
    this.view = { x: (x1 + x2) / 2 + 22 / k, y: (y1 + y2) / 2 - 12 / k, k };
    this.dirty();
  }

  zoom(factor, at) {
    if (!this.view) return;
    this.touched = true;
    const p = at ?? [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2];
    const [x, y] = this.world(...p);
    this.view.k = Math.min(Math.max(this.view.k * factor, 4), 600);
    const [nx, ny] = this.world(...p);
    this.view.x += x - nx;
    this.view.y += y - ny;
    this.dirty();
  }

  world(px, py) {
    const { x, y, k } = this.view;
    return [x + (px - this.canvas.clientWidth / 2) / k, y - (py - this.canvas.clientHeight / 2) / k];
  }

  screen(x, y) {
    const v = this.view;
    return [this.canvas.clientWidth / 2 + (x - v.x) * v.k, this.canvas.clientHeight / 2 - (y - v.y) * v.k];
  }

  dirty() {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame(() => {
      this.scheduled = false;
      this.#draw();
    });
  }

  // Input ----------------------------------------------------------------------------------------

  #point(e) {
    const box = this.canvas.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  }

  #down(e) {
    if (!this.view) return;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(e.pointerId);
    const p = this.#point(e);
    this.pointers.set(e.pointerId, p);
    if (this.pointers.size > 1) { // two fingers move the map
      this.press = null;
      this.pinch = this.#spread();
      return;
    }
    this.press = { at: p, to: p, pan: e.button !== 0 || e.ctrlKey || e.metaKey };
  }

  #move(e) {
    if (!this.pointers.has(e.pointerId)) return;
    const p = this.#point(e), before = this.pointers.get(e.pointerId);
    this.pointers.set(e.pointerId, p);
    if (this.pinch && this.pointers.size > 1) {
      const now = this.#spread();
      this.#pan(now.x - this.pinch.x, now.y - this.pinch.y);
      this.zoom(now.d / this.pinch.d, [now.x, now.y]);
      this.pinch = now;
    } else if (this.press?.pan) {
      this.#pan(p[0] - before[0], p[1] - before[1]);
    } else if (this.press) {
      this.press.to = p;
    }
    this.dirty();
  }

  #up(e) {
    const press = this.press;
    this.#cancel(e);
    if (!press || press.pan) return;
    const [x, y] = this.world(...press.at);
    const drag = Math.hypot(press.to[0] - press.at[0], press.to[1] - press.at[1]) >= DRAG_PX;
    const theta = drag ? Math.atan2(press.at[1] - press.to[1], press.to[0] - press.at[0]) : null;
    this.#go({ x, y, theta });
  }

  #cancel(e) {
    this.pointers.delete(e.pointerId);
    if (this.pointers.size < 2) this.pinch = null;
    this.press = null;
    this.dirty();
  }

  #spread() {
    const [a, b] = [...this.pointers.values()];
    return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, d: Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1) };
  }

  #pan(dx, dy) {
    this.touched = true;
    this.setFollow(false);
    this.view.x -= dx / this.view.k;
    this.view.y += dy / this.view.k;
  }

  #wheel(e) {
    e.preventDefault();
    this.zoom(Math.exp(-e.deltaY / 500), this.#point(e));
  }

  #key(e) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key];
    const turn = { ",": 1, ".": -1 }[e.key];
    const m = this.robots.get(this.chosen)?.parts.motion;
    if (!(step || turn || ["Enter", "Escape", "+", "-"].includes(e.key)) || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    if (e.key === "+" || e.key === "-") return this.zoom(e.key === "+" ? 1.25 : 0.8);
    if (e.key === "Escape") return this.aim(null);
    if (!this.target || this.target.state) {
      if (m?.x === undefined) return;
      this.target = { x: m.x, y: m.y, theta: null };
    }
    const t = this.target;
    if (e.key === "Enter") return this.#go({ x: t.x, y: t.y, theta: t.theta });
    if (step) {
      const far = STEP * (e.shiftKey ? 5 : 1);
      Object.assign(t, { x: t.x + step[0] * far, y: t.y + step[1] * far });
    } else {
      t.theta = (t.theta ?? m?.theta ?? 0) + turn * TURN;
    }
    this.dispatchEvent(new CustomEvent("aim", { detail: t }));
    this.dirty();
  }

  #go(goal) {
    this.aim({ ...goal, state: "sent" });
    this.dispatchEvent(new CustomEvent("go", { detail: goal }));
  }

  setFollow(on) {
    this.follow = on;
    if (on) this.touched = true;
    this.dispatchEvent(new CustomEvent("follow", { detail: on }));
  }

  // Drawing --------------------------------------------------------------------------------------

  #resize() {
    const scale = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * scale);
    this.canvas.height = Math.round(this.canvas.clientHeight * scale);
    if (!this.touched && this.view) this.fit();
    this.#draw();
  }

  #bounds() {
    for (const robot of this.robots.values()) {
      const world = robot.still.world;
      if (world && (world.walls.length || world.bounds[2] > world.bounds[0])) return world.bounds;
    }
    let [x1, y1, x2, y2] = [-3, -2, 3, 2];
    for (const { parts, trail } of this.robots.values()) {
      const g = parts.grid;
      if (g && g.rows) [x1, y1, x2, y2] = [Math.min(x1, g.x), Math.min(y1, g.y), Math.max(x2, g.x + g.columns * g.cell), Math.max(y2, g.y + g.rows * g.cell)];
      const places = [...trail.slice(-200), ...(parts.mission?.way ?? [])];
      for (const [x, y] of places) [x1, y1, x2, y2] = [Math.min(x1, x - 1), Math.min(y1, y - 1), Math.max(x2, x + 1), Math.max(y2, y + 1)];
    }
    return [x1, y1, x2, y2];
  }

  async #unpacked({ packed }) {
    const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // What nobody has seen of the world's map, one bit for each cell, in the colour of the outside.
  async #unsee(robot) {
    const u = robot.still.world?.unseen;
    if (!u) return;
    try {
      const bits = await this.#unpacked(u);
      const canvas = new OffscreenCanvas(u.columns, u.rows), ctx = canvas.getContext("2d");
      ctx.fillStyle = this.c.outside;
      for (let r = 0, i = 0; r < u.rows; r++) {
        for (let c = 0; c < u.columns; c++, i++) if (bits[i >> 3] & (128 >> (i & 7))) ctx.fillRect(c, u.rows - 1 - r, 1, 1);
      }
      robot.unseen = { canvas, ...u };
      this.dirty();
    } catch { /* cells that are none are not drawn */ }
  }

  async #inflate(robot) {
    const g = robot.parts.grid;
    if (!g || !g.rows || !g.columns || g.rows * g.columns > 16e6) return void (robot.grid = null);
    try {
      const cells = await this.#unpacked(g);
      if (cells.length !== g.rows * g.columns || robot.parts.grid !== g) return;
      const image = new ImageData(g.columns, g.rows);
      const dark = document.documentElement.dataset.theme === "dark";
      const free = dark ? [35, 47, 58] : [255, 255, 255], occupied = dark ? [220, 170, 90] : [60, 70, 80];
      for (let r = 0; r < g.rows; r++) {
        for (let c = 0; c < g.columns; c++) {
          const state = cells[(g.rows - 1 - r) * g.columns + c];
          if (state) image.data.set([...(state === 2 ? occupied : free), 255], 4 * (r * g.columns + c));
        }
      }
      const canvas = new OffscreenCanvas(g.columns, g.rows);
      canvas.getContext("2d").putImageData(image, 0, 0);
      robot.grid = { canvas, ...g };
      this.dirty();
    } catch { /* cells that are none are not drawn */ }
  }

  #draw() {
    const { ctx, canvas, c } = this;
    const scale = window.devicePixelRatio || 1;
    ctx.setTransform(scale, 0, 0, scale, 0, 0);
    ctx.fillStyle = c.outside;
    ctx.fillRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    if (!this.view) return;
    ctx.lineCap = ctx.lineJoin = "round";
    const world = [...this.robots.values()].map((r) => r.still.world).find(Boolean);
    this.#floor(world);
    const unseen = [...this.robots.values()].map((r) => r.unseen).find(Boolean);
    if (unseen) this.#cells({ grid: unseen });
    for (const robot of this.robots.values()) if (robot.grid) this.#cells(robot);
    this.#raster();
    if (world) this.#walls(world);
    for (const [name, robot] of this.robots) this.#way(name, robot);
    if (this.graphs) for (const robot of this.robots.values()) this.#graph(robot);
    this.#rehearsed();
    for (const [name, robot] of this.robots) this.#robot(name, robot);
    this.#aimed();
  }

  #floor(world) {
    if (!world || !(world.bounds[2] > world.bounds[0])) return;
    const { ctx, c } = this;
    const [x1, y1, x2, y2] = world.bounds;
    const [ax, ay] = this.screen(x1, y2), [bx, by] = this.screen(x2, y1);
    ctx.fillStyle = c.floor;
    ctx.fillRect(ax, ay, bx - ax, by - ay);
    ctx.font = "600 12px system-ui, sans-serif";
    ctx.fillStyle = c.soft;
    ctx.textBaseline = "top";
    for (const [name, rx1, ry1, rx2, ry2] of world.rooms) {
      const [px, py] = this.screen(rx1, ry2);
      const width = (rx2 - rx1) * this.view.k - 12;
      if (ctx.measureText(name).width <= width) ctx.fillText(name, px + 8, py + 7);
      else if ((ry2 - ry1) * this.view.k > ctx.measureText(name).width + 14 && width > 8) {
        ctx.save();
        ctx.translate(px + 20, py + 8);
        ctx.rotate(Math.PI / 2);
        ctx.fillText(name, 0, 0);
        ctx.restore();
      }
    }
  }

  #cells({ grid: g }) {
    const { ctx } = this, side = g.cell * this.view.k;
    ctx.save();
    ctx.translate(...this.screen(g.x, g.y));
    ctx.rotate(-(g.theta ?? 0));
    ctx.imageSmoothingEnabled = false;
    ctx.drawImage(g.canvas, 0, -g.rows * side, g.columns * side, g.rows * side);
    ctx.restore();
  }

  #raster() {
    const { ctx, c } = this;
    const step = [0.5, 1, 2, 5, 10, 20].find((s) => s * this.view.k >= 44) ?? 50;
    const [x1, y2] = this.world(0, 0), [x2, y1] = this.world(this.canvas.clientWidth, this.canvas.clientHeight);
    ctx.strokeStyle = c.grid;
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (let x = Math.ceil(x1 / step) * step; x <= x2; x += step) { const [p] = this.screen(x, 0); ctx.moveTo(p, 0); ctx.lineTo(p, this.canvas.clientHeight); }
    for (let y = Math.ceil(y1 / step) * step; y <= y2; y += step) { const [, p] = this.screen(0, y); ctx.moveTo(0, p); ctx.lineTo(this.canvas.clientWidth, p); }
    ctx.stroke();
    // The scale bar.
    const px = step * this.view.k, right = this.canvas.clientWidth - 14, y = this.canvas.clientHeight - 34;
    ctx.strokeStyle = ctx.fillStyle = c.soft;
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(right - px, y); ctx.lineTo(right, y);
    ctx.stroke();
    ctx.font = "12px system-ui, sans-serif";
    ctx.textBaseline = "bottom";
    ctx.textAlign = "right";
    ctx.fillText(`${step} m`, right, y - 3);
    ctx.textAlign = "left";
  }

  #walls(world) {
    const { ctx, c } = this;
    const lines = (segments) => {
      ctx.beginPath();
      for (const [x1, y1, x2, y2] of segments) { ctx.moveTo(...this.screen(x1, y1)); ctx.lineTo(...this.screen(x2, y2)); }
      ctx.stroke();
    };
    ctx.strokeStyle = c.wall;
    ctx.lineWidth = Math.min(Math.max(this.view.k * 0.045, 1.6), 5);
    lines(world.walls);
    for (const [x, y, r] of world.columns) { ctx.beginPath(); ctx.arc(...this.screen(x, y), Math.max(r * this.view.k, 1.5), 0, 7); ctx.stroke(); }
    ctx.setLineDash([6, 6]);
    ctx.strokeStyle = c.stop;
    lines(world.forbidden);
    ctx.setLineDash([]);
    for (const [name, [x, y, a]] of Object.entries(world.docks)) this.#arrow(x, y, a, c.good, name);
  }

  // The pose graph, if it is that of the map shown: key scans, loops, and dashed those switched off.
  #graph({ grid, parts: { graph, slam } }) {
    if (!slam || !graph || graph.revision !== grid?.revision) return;
    const { ctx, c } = this;
    const at = graph.places.map(([x, y]) => this.screen(x, y));
    const loops = (pairs, ink) => {
      ctx.strokeStyle = ink;
      ctx.beginPath();
      for (const [a, b] of pairs) { ctx.moveTo(...at[a]); ctx.lineTo(...at[b]); }
      ctx.stroke();
    };
    ctx.lineWidth = 1;
    loops(graph.loops, c.good);
    ctx.setLineDash([4, 3]);
    ctx.lineWidth = 1.5;
    loops(graph.off, c.stop);
    ctx.setLineDash([]);
    ctx.lineWidth = 1;
    ctx.strokeStyle = ctx.fillStyle = c.ink;
    ctx.beginPath();
    for (const place of at) ctx.lineTo(...place);
    ctx.stroke();
    const half = Math.min(1.5, this.view.k / 40); // on a small map they would hide the path
    for (const [px, py] of at) ctx.fillRect(px - half, py - half, 2 * half, 2 * half);
  }

  #way(name, { parts, trail }) {
    const { ctx, c } = this;
    const faint = name !== this.chosen;
    ctx.globalAlpha = faint ? 0.3 : 1;
    ctx.lineWidth = 3;
    let driver;
    for (let i = 1; i < trail.length; i++) {
      const [x, y, agent] = trail[i];
      if (agent !== driver || i === 1) {
        if (i > 1) ctx.stroke();
        driver = agent;
        ctx.strokeStyle = this.colour?.(name, agent) ?? c.soft;
        ctx.beginPath();
        ctx.moveTo(...this.screen(trail[i - 1][0], trail[i - 1][1]));
      }
      ctx.lineTo(...this.screen(x, y));
    }
    if (trail.length > 1) ctx.stroke();
    const m = parts.mission;
    if (m?.way?.length && parts.motion?.x !== undefined) {
      const left = m.way.slice(m.leg);
      ctx.strokeStyle = m.waits ? c.warn : c.soft;
      ctx.lineWidth = 2;
      ctx.setLineDash([2, 7]);
      ctx.beginPath();
      ctx.moveTo(...this.screen(parts.motion.x, parts.motion.y));
      for (const [x, y] of left) ctx.lineTo(...this.screen(x, y));
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.strokeStyle = c.warn; // where nobody has seen the map, it drives at the speed of sight
      ctx.lineWidth = 4;
      ctx.beginPath();
      for (const [x1, y1, x2, y2] of m.unseen ?? []) { ctx.moveTo(...this.screen(x1, y1)); ctx.lineTo(...this.screen(x2, y2)); }
      ctx.stroke();
      const [x, y, a] = m.way.at(-1);
      this.#arrow(x, y, a, c.accent);
    }
    ctx.globalAlpha = 1;
  }

  #robot(name, { parts }) {
    const { ctx, c } = this;
    const m = parts.motion, body = parts.body;
    if (m?.x === undefined) return;
    // On a small map a robot is drawn larger than it is, so that it stays visible.
    const size = Math.max(1, 15 / (((body?.front ?? 0.2) + (body?.rear ?? 0.2)) * this.view.k));
    const [front, rear, half] = [body?.front ?? 0.2, body?.rear ?? 0.2, body?.half_width ?? 0.18].map((m) => m * size);
    const chosen = name === this.chosen;
    if (chosen && parts.near && m.connected) {
      const [co, si] = [Math.cos(m.theta), Math.sin(m.theta)];
      ctx.fillStyle = c.near;
      for (const [x, y] of parts.near) {
        const [px, py] = this.screen(m.x + co * x - si * y, m.y + si * x + co * y);
        ctx.fillRect(px - 1.5, py - 1.5, 3, 3);
      }
    }
    const place = ([x, y, a]) => (u, v) => this.screen(x + Math.cos(a) * u - Math.sin(a) * v, y + Math.sin(a) * u + Math.cos(a) * v);
    const outline = (at) => {
      ctx.beginPath();
      for (const [u, v] of [[front, half], [front, -half], [-rear, -half], [-rear, half]]) ctx.lineTo(...at(u, v));
      ctx.closePath();
    };
    if (m.truth && chosen) {
      outline(place(m.truth));
      ctx.strokeStyle = c.good;
      ctx.lineWidth = 1.2;
      ctx.setLineDash([4, 3]);
      ctx.stroke();
      ctx.setLineDash([]);
    }
    const at = place([m.x, m.y, m.theta]);
    outline(at);
    ctx.globalAlpha = m.connected ? (chosen ? 1 : 0.55) : 0.35;
    ctx.fillStyle = parts.stop?.held ? c.stop : (this.colour?.(name, parts.wheels?.obeyed) ?? c.soft);
    ctx.fill();
    ctx.strokeStyle = c.ink;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    ctx.beginPath();
    for (const [u, v] of [[front * 0.75, 0], [-rear * 0.2, half * 0.6], [-rear * 0.2, -half * 0.6]]) ctx.lineTo(...at(u, v));
    ctx.closePath();
    ctx.fillStyle = "#fff";
    ctx.fill();
    ctx.globalAlpha = 1;
    if (m.covariance) this.#unsure(m);
    if (this.robots.size > 1) {
      ctx.font = `${chosen ? 700 : 500} 12px system-ui, sans-serif`;
      ctx.fillStyle = c.ink;
      ctx.textBaseline = "bottom";
      const [px, py] = this.screen(m.x, m.y);
      ctx.fillText(this.label?.(name) ?? name, px + 12, py - 10);
    }
  }

  // Two standard deviations of the pose.
  #unsure({ x, y, covariance: [xx, xy, yy], lost_s }) {
    const { ctx, c } = this;
    const mean = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy);
    const [long, short] = [mean + apart, mean - apart].map((v) => 2 * Math.sqrt(Math.max(v, 0)) * this.view.k);
    ctx.beginPath();
    ctx.ellipse(...this.screen(x, y), long, short, -Math.atan2(2 * xy, xx - yy) / 2, 0, 7);
    ctx.fillStyle = ctx.strokeStyle = lost_s != null ? c.stop : c.accent;
    ctx.lineWidth = 1;
    ctx.stroke();
    ctx.globalAlpha = 0.14;
    ctx.fill();
    ctx.globalAlpha = 1;
  }

  #arrow(x, y, a, ink, name) {
    const { ctx, c } = this;
    const [px, py] = this.screen(x, y);
    ctx.strokeStyle = ctx.fillStyle = ink;
    ctx.lineWidth = 2.4;
    ctx.beginPath();
    ctx.arc(px, py, 6, 0, 7);
    ctx.fill();
    if (a !== null && a !== undefined) {
      const [co, si] = [Math.cos(a), -Math.sin(a)];
      ctx.beginPath();
      ctx.moveTo(px, py);
      ctx.lineTo(px + 28 * co, py + 28 * si);
      for (const side of [2.6, -2.6]) {
        ctx.moveTo(px + 28 * co, py + 28 * si);
        ctx.lineTo(px + 28 * co + 9 * Math.cos(Math.atan2(si, co) + side), py + 28 * si + 9 * Math.sin(Math.atan2(si, co) + side));
      }
      ctx.stroke();
    }
    if (name) {
      ctx.font = "12px system-ui, sans-serif";
      ctx.fillStyle = c.soft;
      ctx.textBaseline = "top";
      ctx.fillText(name, px + 9, py + 6);
    }
  }

  // A cross marks where a virtual robot ended that did not arrive, a square what was put on its way.
  #rehearsed() {
    const { ctx, c } = this;
    for (const { end, points, put } of this.fan) {
      ctx.strokeStyle = { arrived: c.good, unended: c.soft }[end] ?? c.stop;
      ctx.lineWidth = 2;
      ctx.globalAlpha = 0.7;
      ctx.setLineDash([6, 4]);
      ctx.beginPath();
      for (const [i, [x, y]] of points.entries()) ctx[i ? "lineTo" : "moveTo"](...this.screen(x, y));
      ctx.stroke();
      ctx.setLineDash([]);
      if (put) {
        const [px, py] = this.screen(...put);
        ctx.strokeRect(px - 5, py - 5, 10, 10);
      }
      if (end !== "arrived" && points.length) {
        const [px, py] = this.screen(...points.at(-1));
        ctx.beginPath();
        for (const s of [1, -1]) { ctx.moveTo(px - 4, py - 4 * s); ctx.lineTo(px + 4, py + 4 * s); }
        ctx.stroke();
      }
    }
    ctx.globalAlpha = 1;
  }

  #aimed() {
    const { ctx, c } = this;
    if (this.press && !this.press.pan) {
      const [a, b] = [this.press.at, this.press.to];
      const theta = Math.hypot(b[0] - a[0], b[1] - a[1]) >= DRAG_PX ? Math.atan2(a[1] - b[1], b[0] - a[0]) : null;
      this.#arrow(...this.world(...a), theta, c.accent);
    } else if (this.target) {
      const t = this.target, ink = t.state === "refused" ? c.stop : c.accent;
      if (t.state === "accepted") return;
      this.#arrow(t.x, t.y, t.theta, ink);
      const [px, py] = this.screen(t.x, t.y);
      if (t.state === "refused") {
        ctx.strokeStyle = c.card;
        ctx.lineWidth = 2;
        ctx.beginPath();
        for (const s of [1, -1]) { ctx.moveTo(px - 3, py - 3 * s); ctx.lineTo(px + 3, py + 3 * s); }
        ctx.stroke();
      } else {
        ctx.strokeStyle = ink;
        ctx.lineWidth = 1.5;
        ctx.beginPath();
        ctx.arc(px, py, 12, 0, 7);
        ctx.stroke();
      }
    }
  }
}

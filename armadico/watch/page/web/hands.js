// The stick: keys, a touch pad, a gamepad. An input that disappears releases it.
const SEND_MS = 100;
const DEAD = 0.12;
const SLOWLY = 0.4;
const KEYS = { KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0], KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1] };

export class Stick extends EventTarget {
  constructor(pad, knob) {
    super();
    this.pad = pad;
    this.knob = knob;
    this.keys = new Set();
    this.slowly = false;
    this.finger = null; // {id, v, w}
    this.pads = new Map(); // gamepads that have been moved, by index
    this.held = false;
    pad.addEventListener("pointerdown", (e) => this.#down(e));
    pad.addEventListener("pointermove", (e) => this.#move(e));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(kind, () => this.#lift());
    pad.addEventListener("contextmenu", (e) => e.preventDefault());
    pad.addEventListener("keydown", (e) => this.#key(e, true));
    addEventListener("keyup", (e) => this.#key(e, false));
    pad.addEventListener("blur", () => this.keys.clear());
    for (const kind of ["blur", "pagehide"]) addEventListener(kind, () => this.drop());
    document.addEventListener("visibilitychange", () => document.hidden && this.drop());
    addEventListener("gamepaddisconnected", (e) => {
      this.pads.delete(e.gamepad.index);
      this.#tick();
      this.dispatchEvent(new CustomEvent("pads", { detail: `${e.gamepad.id} is unplugged: released` }));
    });
    addEventListener("gamepadconnected", (e) => this.dispatchEvent(new CustomEvent("pads", { detail: `${e.gamepad.id}: left stick` })));
    setInterval(() => this.#tick(), SEND_MS);
  }

  // Release all inputs now.
  drop() {
    this.keys.clear();
    this.finger = null;
    this.pads.clear();
    this.#tick();
  }

  // The stick's position in shares, by priority from finger, keys or gamepad; null: released.
  where() {
    if (this.finger) return [this.finger.v, this.finger.w];
    if (this.keys.size) {
      const sum = [0, 0];
      for (const code of this.keys) { sum[0] += KEYS[code][0]; sum[1] += KEYS[code][1]; }
      const most = this.slowly ? SLOWLY : 1;
      return sum.map((s) => Math.max(-1, Math.min(1, s)) * most);
    }
    return this.#gamepad();
  }

  #gamepad() {
    if (document.hidden || !document.hasFocus() || this.away?.()) return null;
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (!pad?.connected) continue;
      const [x, y] = [pad.axes[0] ?? 0, pad.axes[1] ?? 0];
      if (Math.hypot(x, y) > DEAD) {
        this.pads.set(pad.index, true);
        return [-y, -x].map((s) => Math.abs(s) < DEAD ? 0 : Math.max(-1, Math.min(1, s)));
      }
    }
    this.pads.clear();
    return null;
  }

  #down(e) {
    e.preventDefault();
    this.pad.focus({ preventScroll: true });
    this.pad.setPointerCapture(e.pointerId);
    this.finger = { id: e.pointerId, v: 0, w: 0 };
    this.#move(e);
  }

  #move(e) {
    if (this.finger?.id !== e.pointerId) return;
    const box = this.pad.getBoundingClientRect();
    const reach = box.width * 0.36;
    let x = (e.clientX - box.left - box.width / 2) / reach, y = (e.clientY - box.top - box.height / 2) / reach;
    const far = Math.max(Math.hypot(x, y), 1);
    [x, y] = [x / far, y / far];
    Object.assign(this.finger, { v: Math.abs(y) < DEAD ? 0 : -y, w: Math.abs(x) < DEAD ? 0 : -x });
    this.#show();
  }

  #lift() {
    if (!this.finger) return;
    this.finger = null;
    this.#tick();
  }

  #key(e, down) {
    if (e.key === "Shift") this.slowly = e.shiftKey;
    if (!KEYS[e.code] || e.ctrlKey || e.metaKey || e.altKey) return;
    if (down) {
      e.preventDefault();
      this.slowly = e.shiftKey;
      const fresh = !this.keys.has(e.code);
      this.keys.add(e.code);
      if (fresh) this.#tick();
    } else if (this.keys.delete(e.code)) {
      this.#tick();
    }
  }

  #tick() {
    const at = this.where();
    this.#show(at);
    if (at) this.dispatchEvent(new CustomEvent("stick", { detail: { v: at[0], w: at[1], held: true } }));
    else if (this.held) this.dispatchEvent(new CustomEvent("stick", { detail: { v: 0, w: 0, held: false } }));
    this.held = Boolean(at);
  }

  #show(at = this.where()) {
    this.pad.classList.toggle("on", Boolean(at));
    const reach = this.pad.clientWidth * 0.33;
    this.knob.style.transform = at ? `translate(${-at[1] * reach}px, ${-at[0] * reach}px)` : "";
  }
}

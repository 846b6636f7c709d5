// The WebSocket to the server: receives data to show, and sends requests, which are answered.
const PROTOCOL = "armadico.page";
const AGAIN_MS = [300, 700, 1500, 3000];
const FULL = 1013; // the server closes with it: another browser has this one's place
const SILENT_MS = 1500; // timeout: the server sends the time every 0.5 s, whatever the robot does

export function token() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found !== null) {
    sessionStorage.setItem("token", found);
    history.replaceState(null, "", location.pathname); // it does not stay in the address bar
  }
  return sessionStorage.getItem("token") ?? "";
}

function subprotocol(text) {
  const bytes = new TextEncoder().encode(text);
  const packed = btoa(String.fromCharCode(...bytes));
  return "token." + packed.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

export class Link extends EventTarget {
  constructor() {
    super();
    this.up = false;
    this.silent = 0;
    this.number = 0;
    this.waiting = new Map();
    this.tries = 0;
    setInterval(() => this.#check(), 250);
  }

  async open() {
    clearTimeout(this.timer);
    this.timer = null;
    const known = token();
    try {
      const headers = known ? { Authorization: `Bearer ${known}` } : {};
      const reply = await fetch("/allowed", { headers });
      if (!reply.ok) {
        const why = await reply.text();
        this.#notify("refused", { status: reply.status, why });
        if (reply.status !== 401) this.#again();
        return;
      }
    } catch {
      return this.#again();
    }
    const offered = known ? [PROTOCOL, subprotocol(known)] : [PROTOCOL];
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`, offered);
    const before = this.socket;
    this.socket = socket;
    before?.close(); // opened again with another token
    socket.onmessage = (event) => this.#receive(JSON.parse(event.data));
    socket.onclose = (event) => this.#close(socket, event);
  }

  // Send a request; resolves to the answer {ok, text}. The caller repeats a stop that was not sent.
  request(what) {
    const id = ++this.number;
    return new Promise((done) => {
      if (!this.up) {
        done({ ok: false, text: "NOT SENT: no connection", unsent: true });
        if (what.do === "stop" && this.timer) this.open(); // it waits for its next attempt
        return;
      }
      this.waiting.set(id, done);
      this.socket.send(JSON.stringify({ id, ...what }));
    });
  }

  // Send a request that is answered only if it is refused.
  send(what) {
    if (this.up && this.socket.bufferedAmount < 4096) {
      this.socket.send(JSON.stringify({ id: ++this.number, ...what }));
    }
  }

  #receive(message) {
    this.receivedAt = performance.now();
    if (message.type === "hello") {
      this.up = true;
      this.tries = 0;
      this.#notify("hello", message);
      this.#notify("change");
    } else if (message.type === "state") {
      this.#notify("state", message);
    } else if (message.type === "answer") {
      const done = this.waiting.get(message.id);
      if (message.over) this.waiting.delete(message.id);
      if (done && message.over) done(message);
      else this.#notify("remark", message);
    }
  }

  #close(socket, { code, reason }) {
    if (socket !== this.socket) return;
    this.up = false;
    for (const done of this.waiting.values()) done({ ok: false, text: "the connection was lost before the answer: the result is not known" });
    this.waiting.clear();
    this.#notify("change");
    if (code === FULL) {
      this.tries = AGAIN_MS.length;
      this.#notify("refused", { status: code, why: reason });
    }
    this.#again();
  }

  #again() {
    const wait = AGAIN_MS[Math.min(this.tries++, AGAIN_MS.length - 1)];
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.open(), wait);
  }

  #check() {
    const silent = this.up && performance.now() - this.receivedAt > SILENT_MS;
    if (silent !== this.silent) {
      this.silent = silent;
      this.#notify("change");
    }
  }

  #notify(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

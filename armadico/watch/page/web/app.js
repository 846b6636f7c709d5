// The page: keeps the server's data by robot and part, draws them, and sends the operator's requests.
import { Stick } from "./hands.js";
import { Link } from "./link.js";
import { Plan } from "./map.js";
import { $, dot, node, put, rows } from "./panels.js";

const link = new Link();
const plan = new Plan($("map"));
const stick = new Stick($("pad"), $("knob"));
const robots = new Map(); // by namespace: {still, parts}
let chosen = "";
let me = "";
let stopping = false; // stop pressed without a connection
let pressed = 0; // stops that were sent and have no answer yet

const here = () => robots.get(chosen) ?? { still: {}, parts: {} };
const degrees = (a) => Math.round((a * 180) / Math.PI);
// Names of a fleet's robots begin with the fleet's name.
const short = (name) => {
  const last = name.split("/").pop();
  return [...robots.keys()].filter((each) => each.split("/").pop() === last).length > 1 ? name : last;
};
const number = (text) => (text.trim() === "" ? NaN : Number(text.replace(",", ".")));

// Messages from the server -----------------------------------------------------------------------

link.addEventListener("hello", ({ detail }) => {
  me = detail.you;
  $("looking").hidden = detail.may;
  robots.clear();
  for (const [name, still] of Object.entries(detail.robots)) robots.set(name, { still, parts: {} });
  plan.hello(detail.robots);
  const kept = sessionStorage.getItem("robot");
  choose(robots.has(chosen) ? chosen : robots.has(kept) ? kept : [...robots.keys()][0]);
  if (stopping) stop([...robots.keys()]);
});

link.addEventListener("state", ({ detail }) => {
  now = detail.t;
  for (const [name, parts] of Object.entries(detail.robots)) {
    const robot = robots.get(name);
    if (!robot) continue;
    Object.assign(robot.parts, parts);
    plan.state(name, parts);
    if (name === chosen) draw(parts);
  }
  if (Object.values(detail.robots).some((p) => p.stop || p.motion)) tabs();
});

link.addEventListener("change", connection);
link.addEventListener("remark", ({ detail }) => remark(detail.text, detail.ok));
link.addEventListener("refused", ({ detail }) => {
  connection(null, detail.why);
  if (detail.status === 1013) remark(detail.why, false);
  if (detail.status !== 401) return;
  ask(`${detail.why[0].toUpperCase()}${detail.why.slice(1)}.`);
});
$("looking").addEventListener("click", () => ask("Without it, this page shows the robot and stops it."));

function ask(why) {
  put($("doortext"), why);
  if (!$("door").open) $("door").showModal();
}

$("key").addEventListener("submit", () => {
  sessionStorage.setItem("token", $("token").value.trim());
  link.open();
});

let now = 0;

function connection(_, why = "") {
  const pill = $("link"), state = link.up && !link.silent;
  pill.className = `pill ${state ? "up" : "down"}`;
  put(pill, state ? "connected" : link.up ? "server silent" : why ? "refused" : "no connection");
  document.body.classList.toggle("cut", !state);
  latch();
}

function choose(name) {
  if (name === undefined) return;
  if (name !== chosen) stick.drop();
  chosen = name;
  sessionStorage.setItem("robot", name);
  plan.choose(name);
  askedFor(null);
  $("asks").hidden = !here().still.rehearses;
  rows($("mission"), [], () => "", () => {});
  const places = (here().still.places ?? []).map(([name]) => node("option", { value: name, textContent: name }));
  $("place").replaceChildren(node("option", { value: "", textContent: "..." }), ...places);
  $("places").hidden = places.length === 0;
  $("mission").replaceChildren(...(here().still.missions ?? []).map((m) => node("option", { value: m.name, textContent: m.title ? `${m.name}: ${m.title}` : m.name })));
  tabs();
  draw({ ...empty, ...here().parts });
}

const empty = { body: null, motion: {}, stop: {}, mission: {}, wheels: { contenders: [] }, resources: [], exchanges: [], agents: [], board: [], log: [], could: [], approvals: [], standing: null, hand: {}, parameters: [], slam: null };

function tabs() {
  $("robots").hidden = robots.size < 2;
  const found = [...robots].map(([name, { parts }]) => ({ name, held: Boolean(parts.stop?.held), on: name === chosen }));
  rows($("robots"), found, (r) => r.name, (child, r) => {
    const button = node("button", { textContent: short(r.name) + (r.held ? " ■" : ""), ariaLabel: r.held ? `${r.name}, stopped` : r.name, onclick: () => choose(r.name) });
    button.setAttribute("aria-current", r.on);
    child.replaceChildren(button);
  });
}

// Drawing ----------------------------------------------------------------------------------------

const drawers = { motion: vitals, stop: latch, standing: why, wheels: contest, resources: others, exchanges, agents, could: agents, approvals, board, log, hand, parameters, slam };

function draw(parts) {
  for (const name of Object.keys(parts)) if (name !== "exchanges") drawers[name]?.();
  exchanges();
  if (parts.mission || parts.motion) why();
}

function vitals() {
  const m = here().parts.motion ?? {};
  const words = [];
  if (m.v !== undefined) words.push(`${Math.abs(m.v).toFixed(2)} m/s`);
  if (m.battery) words.push(m.battery);
  if (m.x !== undefined) words.push(`(${m.x.toFixed(2)}, ${m.y.toFixed(2)}) ${degrees(m.theta)}°`);
  put($("vitals"), words.join("  ·  "));
}

function latch() {
  const { parts } = here(), s = parts.stop ?? {}, m = parts.motion ?? {};
  const cut = !link.up || link.silent;
  const many = robots.size > 1;
  $("latch").classList.toggle("many", many);
  $("stopall").hidden = !many;
  put($("stopkey"), many ? `${short(chosen)} · space: all` : "space bar");
  const sent = s.asked || stopping || pressed > 0;
  $("stop").className = s.held && !cut ? "held" : sent ? "sent" : "";
  put($("stop").querySelector("b"), s.held && !cut ? "STOPPED" : "STOP");
  $("resume").disabled = cut || !(s.stopped || s.asked);
  const moving = Math.max(Math.abs(m.v ?? 0), Math.abs(m.w ?? 0)) > 0.02;
  let text = "";
  if (stopping) text = "NOT SENT: no connection. It is sent when the connection is back.";
  else if (cut && pressed) text = "Sent, but the connection is lost: not known whether the robot received it. Stop it at the robot.";
  else if (cut) text = robots.size ? "No connection: the data shown are stale. Stop it at the robot." : "";
  else if (s.held) text = `Stopped, confirmed by the robot${s.by ? `; pressed by ${s.by}` : ""} (code ${s.code})${moving ? "; it is still braking" : ""}.`;
  else if (sent) text = "Sent, not yet acknowledged by the robot.";
  else if (s.stopped) text = `No data from the robot; it last reported a stop by ${s.by || "an unknown sender"}.`;
  else if (s.known && !m.connected) text = `No data from the robot for ${Math.round(m.silent_s)} s.`;
  put($("latched"), text);
  $("latched").className = stopping || cut || (sent && !s.held) || (s.known && !m.connected) ? "alarm" : "";
}

function why() {
  const { parts } = here(), found = parts.standing, mission = parts.mission ?? {};
  const card = $("why");
  if (!found) return put($("whyhead"), "Waiting for the robot");
  const [first, ...rest] = found.sentences;
  const going = !found.stands && mission.state === "driving" ? ` ${(mission.to_go ?? 0).toFixed(1)} m to go${mission.silent_s ? ` ${Math.round(mission.silent_s)} s ago` : ""}${mission.unseen_m ? `; ${mission.unseen_m.toFixed(1)} m of the path lead through what nobody has seen` : ""}.` : "";
  put($("whyhead"), (first ?? "").replace(/ at ([\d.-]+) m\/s, [\d.-]+ rad\/s/, " at $1 m/s") + going);
  if (mission.late && mission.state === "driving") rest.push(`The mission is ${mission.late}.`);
  if (mission.tasks) rest.push(mission.tasks);
  const wrong = (found.beside ?? []).filter((text) => text.startsWith("wrong: "));
  rest.push(...(found.beside ?? []).map((text) => text.replaceAll("`", "")));
  rows($("whylines"), rest.map((text, i) => ({ text, i })), (r) => r.i, (child, r) => put(child, r.text));
  const doable = { stop: "Resume releases it", "no goal": "Click the map to set one" };
  const todo = doable[found.cause?.sort] ?? (found.cause?.todo ?? "").replaceAll("`", "");
  put($("whytodo"), found.stands && todo ? `${todo[0].toUpperCase()}${todo.slice(1)}.` : "");
  card.className = `card ${!parts.motion?.connected ? "dead" : found.stands || wrong.length ? "stands" : ""}`;
}

const colourOf = (name) => {
  const w = here().parts.wheels;
  return w?.contenders?.find((c) => c.name === name)?.colour ?? here().parts.agents?.find((a) => a.name === name)?.colour ?? null;
};
plan.label = short;
plan.colour = (robot, name) => {
  const parts = robots.get(robot)?.parts;
  return name ? parts?.wheels?.contenders?.find((c) => c.name === name)?.colour ?? null : null;
};

function contest() {
  const w = here().parts.wheels ?? { contenders: [] };
  rows($("contenders"), w.contenders, (c) => c.name, (child, c) => {
    const bar = node("i");
    bar.style.width = `${Math.round(100 * (c.utility ?? 0))}%`;
    bar.style.background = c.colour;
    child.className = c.drives ? "drives" : "";
    const tags = [c.drives && node("span", { class: "tag", textContent: "drives" }), c.critical && node("span", { class: "tag hot", textContent: "critical" })].filter(Boolean);
    child.replaceChildren(
      node("div", { class: "row" }, dot(c.colour), node("span", { class: "name", textContent: c.name }), node("span", { class: "bar" }, bar), node("span", { class: "num", textContent: c.utility === null || c.utility === undefined ? "–" : c.utility.toFixed(2) }), ...tags),
      c.reason && !c.drives ? node("small", { textContent: c.reason }) : "",
    );
  }, "No agent competes for the wheels.");
  const names = [...new Set((plan.robots.get(chosen)?.trail ?? []).map((p) => p[2]).filter(Boolean))];
  rows($("legend"), names.map((name) => ({ name, colour: colourOf(name) })), (r) => r.name, (child, r) => {
    const line = node("i");
    line.style.background = r.colour ?? "currentcolor";
    child.replaceChildren(line, r.name);
  });
}

function slam() {
  const found = here().parts.slam;
  $("slam").hidden = $("graph").hidden = !found;
  if (!found) return;
  const key = (kind, text) => node("span", { class: kind }, node("i"), text);
  $("slam").replaceChildren(
    ...(found.uncertain ? [node("b", { textContent: `The map may be wrong: ${found.uncertain}` })] : []),
    `map revision ${found.revision}`,
    key("scans", `${found.key_scans} key scans`), key("loops", `${found.loops} loops`),
    ...(found.loops_off ? [key("off", `${found.loops_off} of them switched off`)] : []),
  );
}

function others() {
  const found = here().parts.resources ?? [];
  put($("others"), found.map((r) => `${r.resource}: ${r.obeyed ?? (r.contenders.length ? `${r.contenders.map((c) => c.name).join(", ")} (idle)` : "no agent")}`).join(" · "));
}

function ago(t) {
  const s = Math.max(now - t, 0);
  return s < 60 ? `${Math.round(s)} s` : s < 3600 ? `${Math.round(s / 60)} min` : `${Math.round(s / 3600)} h`;
}

function exchanges() {
  const found = [...(here().parts.exchanges ?? [])].reverse().slice(0, 12);
  rows($("exchanges"), found.map((e) => ({ ...e, ago: ago(e.t) })), (e) => `${e.t}${e.to}`, (child, e) => {
    const winner = e.to === null ? ["released"] : [dot(colourOf(e.to) ?? "gray"), node("b", { textContent: e.to })];
    child.className = "";
    child.replaceChildren(node("div", { class: "row" },
      node("span", { class: "time", textContent: `${e.ago} ago` }),
      node("span", { class: "soft", textContent: e.from ?? "no agent" }), node("span", { textContent: "→", ariaLabel: "to" }), ...winner,
      node("span", { class: "grow" }),
      e.utility !== undefined ? node("span", { class: "num", textContent: e.utility.toFixed(2) }) : "",
      e.critical ? node("span", { class: "tag hot", textContent: "critical" }) : ""));
  }, "None yet.");
}

function agents() {
  const { agents: known = [], could = [] } = here().parts;
  rows($("company"), known, (a) => a.name + a.instance, (child, a) => {
    const restart = a.kept ? node("button", { textContent: "Restart", ariaLabel: `Restart ${a.name}`, onclick: () => sure(restart, () => request({ do: "restart", agent: a.name, pid: a.pid })) }) : null;
    const state = a.alive ? [a.host, a.pid ? `pid ${a.pid}` : ""].filter(Boolean).join(", ") : `${a.state ?? "gone"}${a.why ? `: ${a.why}` : ""} on ${a.host}`;
    child.replaceChildren(node("div", { class: "row" }, dot(a.colour, !a.alive),
      node("span", { class: a.alive ? "grow" : "grow late" }, node("span", { textContent: a.name }), " ", node("small", { textContent: state })), restart));
  }, "No agent is alive.");
  const kept = known.some((a) => a.kept);
  $("could").replaceChildren(
    ...(kept || !known.length ? [] : ["These agents are not supervised: an agent that ends is not restarted. armadico up starts supervised agents. "]),
    ...could.flatMap((name, i) => [i ? " " : "Can be started: ", node("button", { textContent: name, ariaLabel: `Start ${name}`, onclick: () => request({ do: "start", agent: name }) })]),
  );
}

function approvals() {
  const found = here().parts.approvals ?? [];
  $("approvals").hidden = !found.length;
  for (const code of foretold.keys()) if (!found.some((a) => a.code === code)) foretold.delete(code);
  found.forEach(foretell);
  fans();
  rows($("asking"), found.map((a) => ({ ...a, says: foretold.get(a.code)?.says ?? "" })), (a) => a.code, (child, a) => {
    if (!child.firstChild) { // a button that is replaced each second loses its focus and half a click
      const answer = (choice, words) => node("button", { textContent: words, ariaLabel: `${words} to ${a.by}: ${a.what}`, onclick: () => request({ do: "approve", code: a.code, choice }) });
      child.append(node("div", { class: "row" },
        node("span", { class: "grow" }, node("b", { textContent: a.by }), ` asks for ${a.what}`, node("br"), node("small"), node("p", { class: "small" })),
        answer("yes", "Yes"), answer("no", "No"), answer("always", "Always here")));
    }
    put(child.querySelector("small"), `${a.why}; ${a.left} s left`);
    put(child.querySelector("p"), a.says);
  });
}

// What a person is asked to allow is driven virtually first, as with "ask first".
const foretold = new Map(); // by the code of a request: {says, paths}

async function foretell(a) {
  if (!a.goal.length || !here().still.rehearses || !$("looking").hidden || foretold.has(a.code)) return;
  foretold.set(a.code, { says: "Driving there virtually ...", paths: [] });
  const reply = await link.request({ do: "rehearse", robot: chosen, x: a.goal[0], y: a.goal[1] });
  if (!foretold.has(a.code)) return; // it is over
  foretold.set(a.code, { says: reply.text, paths: reply.more?.paths ?? [] });
  if (!reply.ok) setTimeout(() => foretold.delete(a.code), 3000); // another one is under way, perhaps
  approvals();
}

// The map shows the paths of the goal that is asked for here, else of one that a program asks for.
function fans() {
  const paths = asked ? fan : [...foretold.values()].flatMap((each) => each.paths);
  if (paths.length || plan.fan.length) {
    plan.fan = paths;
    plan.dirty();
  }
}

function board() {
  rows($("board"), here().parts.board ?? [], (m) => m.number, (child, m) => {
    const cancel = m.over ? null : node("button", { textContent: "Cancel", ariaLabel: `Cancel ${m.name}`, onclick: () => request({ do: "cancel", mission: m.number }) });
    child.replaceChildren(node("div", { class: "row" },
      node("span", { class: "grow" }, node("b", { textContent: m.name }), " ", node("span", { class: "tag", textContent: m.state }), node("br"), node("small", { textContent: m.over ? m.note || `${m.done} done` : m.doing })), cancel),
    m.ahead.length && !m.over ? node("small", { textContent: `then ${m.ahead.slice(0, 5).join(", ")}` }) : "");
  }, "No missions.");
}

const LEVELS = (level) => (level >= 40 ? "late" : "");
function log() {
  const found = [...(here().parts.log ?? [])].reverse();
  rows($("log"), found, (l) => `${l.t}${l.name}${l.text}`, (child, l) => {
    child.replaceChildren(node("span", { class: `grow ${LEVELS(l.level)}` }, node("b", { textContent: l.name }), ` ${l.text}`));
  }, "No log lines.");
}

function hand() {
  const h = here().parts.hand ?? {};
  $("startteleop").hidden = h.there || !(here().parts.could ?? []).includes("teleop");
  const mine = h.hand === me && me !== "";
  let text = "Free.";
  if (!h.there) text = "The stick has no effect: the agent teleop is not alive.";
  else if (h.hand && !mine) text = `${h.hand} has the stick.`;
  else if (mine && h.holds) text = `You drive: ${(h.v ?? 0).toFixed(2)} m/s.`;
  else if (mine) text = "You have the stick, but another agent holds the wheels.";
  if (h.note) text += ` ${h.note}`;
  put($("handtext"), text);
}

function parameters() {
  const found = here().parts.parameters ?? [];
  rows($("parameters"), found.map((p) => ({ instance: p.instance, agent: p.agent, names: p.rows.map((r) => r.name) })), (p) => p.instance, (child, p) => {
    child.replaceChildren(node("fieldset", {}, node("legend", { textContent: p.agent }), ...p.names.map((name) => tunable(p, name))));
  }, "No agent has parameters.");
  for (const { instance, rows: known } of found) {
    for (const row of known) {
      const box = document.querySelector(`[data-tune="${CSS.escape(instance + row.name)}"]`);
      if (!box) continue;
      const input = box.querySelector("input, select");
      const label = box.querySelector("label");
      label.title = `${row.wanted}; started with ${row.begun}`;
      label.classList.toggle("changed", row.json !== row.begun);
      put(box.querySelector("span"), row.unit);
      if (input.tagName === "SELECT" && !input.options.length) {
        const words = row.words.length ? row.words.map((w) => JSON.stringify(w)) : ["true", "false"];
        input.replaceChildren(...[...words, ...(row.optional ? ["null"] : [])].map((w) => node("option", { value: w, textContent: w === "null" ? "none" : w.replaceAll('"', "") })));
      }
      if (document.activeElement !== input && !input.dataset.pending) input.value = input.tagName === "SELECT" ? row.json : plainly(row.json);
    }
  }
}

// Five digits are enough to edit; the label's title has the initial value.
const plainly = (json) => {
  if (json === "null") return "";
  const value = Number(json);
  return Number.isFinite(value) ? String(Number(value.toPrecision(5))) : json.replace(/^"(.*)"$/, "$1");
};

function tunable(p, name) {
  const row = here().parts.parameters.find((x) => x.instance === p.instance).rows.find((r) => r.name === name);
  const id = `t-${p.instance}-${name}`;
  const chooses = row.words.length > 0 || row.json === "true" || row.json === "false";
  const input = node(chooses ? "select" : "input", { id, ...(chooses ? {} : { inputMode: "decimal", placeholder: row.optional ? "none" : "" }) });
  const wrong = node("small", { role: "alert" });
  const box = node("div", { class: "tune" }, node("label", { htmlFor: id, textContent: name }), input, node("span", { class: "soft" }), wrong);
  box.dataset.tune = p.instance + name;
  input.addEventListener("change", async () => {
    const text = input.value.trim();
    const json = chooses ? text : text === "" ? "null" : Number.isFinite(number(text)) ? String(number(text)) : JSON.stringify(text);
    input.dataset.pending = "1";
    const reply = await link.request({ do: "set", robot: chosen, instance: p.instance, name, json });
    delete input.dataset.pending;
    put(wrong, reply.ok ? "" : reply.text);
    if (reply.ok) remark(reply.text, true);
    parameters();
  });
  return box;
}

// Requests of the operator -----------------------------------------------------------------------

async function request(what, robot = chosen) {
  const reply = await link.request({ robot, ...what });
  remark(reply.text, reply.ok);
  return reply;
}

function remark(text, ok = true) {
  const line = node("p", { class: ok ? "" : "no", textContent: text });
  $("remarks").append(line);
  while ($("remarks").children.length > 4) $("remarks").firstChild.remove();
  setTimeout(() => line.remove(), ok ? 5000 : 12000);
}

// Actions that cannot be undone need a second click.
function sure(button, then) {
  if (button.dataset.sure) {
    delete button.dataset.sure;
    button.textContent = button.dataset.was;
    then();
    return;
  }
  Object.assign(button.dataset, { sure: "1", was: button.textContent });
  button.textContent = "Sure?";
  setTimeout(() => {
    if (button.dataset.sure) button.textContent = button.dataset.was;
    delete button.dataset.sure;
  }, 4000);
}

async function stop(names) {
  stick.drop();
  const replies = names.map((robot) => link.request({ do: "stop", robot }));
  stopping = !link.up;
  if (link.up) pressed += 1;
  latch();
  const answers = await Promise.all(replies);
  if (!answers.some((reply) => reply.unsent)) pressed -= 1;
  for (const reply of answers) if (!reply.unsent && !reply.ok) remark(reply.text, false);
  latch();
}

// On touch, not on release. Enter causes a click with detail 0.
const stops = { stop: () => stop([chosen]), stopall: () => stop([...robots.keys()]) };
for (const [id, act] of Object.entries(stops)) {
  $(id).addEventListener("pointerdown", act);
  $(id).addEventListener("click", (event) => event.detail === 0 && act());
}
$("resume").addEventListener("click", () => {
  stopping = false;
  request({ do: "resume", press: here().parts.stop?.press ?? "0" });
});

// Space stops, wherever the focus is; Enter presses buttons.
addEventListener("keydown", (event) => {
  if (event.code !== "Space" || event.ctrlKey || event.metaKey || event.altKey) return;
  if ($("door").open) return;
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) stop([...robots.keys()]);
}, { capture: true });
addEventListener("keyup", (event) => event.code === "Space" && !$("door").open && event.preventDefault(), { capture: true });

// With "ask first" a goal is rehearsed, and the robot goes there after a second yes.
let asked = null; // the goal whose rehearsal is shown or under way
let fan = []; // its paths

function askedFor(goal, says = "", paths = []) {
  asked = goal;
  fan = paths;
  fans();
  if (goal) $("tab-drive").click(); // the answer is there
  put($("says"), says);
  $("rehearsed").hidden = !goal;
}

async function goto(goal) {
  if (!$("ask").checked || $("asks").hidden) return drive(goal);
  const robot = chosen;
  plan.aim({ ...goal, state: "sent" });
  askedFor(goal, "Driving there virtually ...");
  const reply = await link.request({ do: "rehearse", robot, ...goal });
  if (asked !== goal) return;
  askedFor(goal, reply.text, reply.more?.paths ?? []);
  $("rehearsed").className = reply.ok ? reply.more.answer : "unknown";
  $("godo").focus({ preventScroll: true }); // the map stays in view
}

$("godo").addEventListener("click", () => {
  const goal = asked;
  askedFor(null);
  drive(goal);
});
$("gonot").addEventListener("click", () => {
  askedFor(null);
  plan.aim(null);
});

async function drive(goal) {
  const aimed = { ...goal, state: "sent" };
  plan.aim(aimed);
  const reply = await request({ do: "go", ...goal });
  if (plan.target !== aimed) return;
  plan.aim({ ...goal, state: reply.ok ? "accepted" : "refused" });
}

plan.addEventListener("go", ({ detail }) => goto(detail));
plan.addEventListener("aim", ({ detail }) => {
  $("gox").value = detail.x.toFixed(2);
  $("goy").value = detail.y.toFixed(2);
  $("goa").value = detail.theta === null ? "" : degrees(detail.theta);
});
plan.addEventListener("follow", ({ detail }) => $("follow").setAttribute("aria-pressed", detail));
// A place by its name fills in its pose, so that it is seen before the robot goes.
$("place").addEventListener("change", () => {
  const found = (here().still.places ?? []).find(([name]) => name === $("place").value);
  if (!found) return;
  const [, x, y, theta] = found;
  $("gox").value = x.toFixed(2);
  $("goy").value = y.toFixed(2);
  $("goa").value = theta === null ? "" : degrees(theta);
});
$("go").addEventListener("submit", (event) => {
  event.preventDefault();
  const [x, y, a] = ["gox", "goy", "goa"].map((id) => number($(id).value));
  const theta = $("goa").value.trim() === "" ? null : ((((a + 180) % 360) + 360) % 360 - 180) * Math.PI / 180;
  if (![x, y, theta ?? 0].every(Number.isFinite)) return remark("enter x and y in metres, and the heading in degrees", false);
  goto({ x, y, theta });
});
$("order").addEventListener("submit", (event) => {
  event.preventDefault();
  request({ do: "order", mission: $("mission").value });
});

stick.addEventListener("stick", ({ detail }) => link.send({ do: "stick", robot: chosen, ...detail, cycle: here().parts.motion?.cycle ?? 0 }));
stick.addEventListener("pads", ({ detail }) => put($("gamepad"), detail));
$("startteleop").addEventListener("click", () => request({ do: "start", agent: "teleop" }));

$("closer").addEventListener("click", () => plan.zoom(1.3));
$("farther").addEventListener("click", () => plan.zoom(1 / 1.3));
$("fit").addEventListener("click", () => { plan.touched = false; plan.setFollow(false); plan.touched = false; plan.fit(); });
$("follow").addEventListener("click", () => plan.setFollow(!plan.follow));
$("graph").addEventListener("click", () => {
  plan.graphs = !plan.graphs;
  $("graph").setAttribute("aria-pressed", plan.graphs);
  plan.dirty();
});

// Tabs, also with the arrow keys.
const all = [...document.querySelectorAll("#tabs [role=tab]")];
function show(tab) {
  for (const each of all) {
    const on = each === tab;
    each.setAttribute("aria-selected", on);
    each.tabIndex = on ? 0 : -1;
    $(each.getAttribute("aria-controls")).hidden = !on;
  }
}
for (const tab of all) {
  tab.addEventListener("click", () => show(tab));
  tab.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const next = all[(all.indexOf(tab) + by + all.length) % all.length];
    show(next);
    next.focus();
  });
}

$("ask").checked = localStorage.getItem("ask") === "1";
$("ask").addEventListener("change", () => localStorage.setItem("ask", $("ask").checked ? "1" : "0"));

// Light or dark: the system's setting, until the button is used.
const system = matchMedia("(prefers-color-scheme: dark)");
function theme() {
  const wanted = localStorage.getItem("theme") ?? (system.matches ? "dark" : "light");
  document.documentElement.dataset.theme = wanted;
  put($("theme"), wanted === "dark" ? "☀" : "☾");
  plan.colours();
}
system.addEventListener("change", theme);
$("theme").addEventListener("click", () => {
  localStorage.setItem("theme", document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  theme();
});

// For tests and the console.
globalThis.armadico = { plan, robots, stick, link };

theme();
connection();
link.open();
